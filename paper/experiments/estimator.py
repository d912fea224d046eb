"""The leader estimator with and without the leader's velocity fed forward."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from paper import columns as col
from paper.claims import FAILS, HOLDS
from paper.columns import FlightColumn, flights_table
from paper.experiment_result import Claim, ExperimentResult, Figure, Table
from paper.figures import style
from paper.flights import JudgedFlight, fly_judged
from paper.output import ExperimentFolder, time_column
from ptnsbc_core.types import Array
from ptnsbc_sim.verdict.deadline import TOLERANCE_M

_SHOWN_S = 15.0
_FLOOR_M = 1e-6


class EstimatorVariant(NamedTuple):
    """One estimator: the followers with a leader link, tf2, and whether the leader's velocity is fed forward."""

    links: str
    leader_links: tuple[int, ...]
    deadline_s: float
    feed_forward: bool


# One link makes lambda_min small: with tf2 = 1.5 s the gain would be too large for a period of 10 ms.
_ALL, _ONE = ("all hear the leader", (2, 3, 4, 5), 1.5), ("only UAV 2 does", (2,), 3.0)
CASES = (
    EstimatorVariant(*_ALL, True),
    EstimatorVariant(*_ALL, False),
    EstimatorVariant(*_ONE, True),
    EstimatorVariant(*_ONE, False),
)


def flight(case: EstimatorVariant, duration_s: float = 30.0) -> JudgedFlight:
    """`paper_5_free` on the six-input plant, profile `soft`, with another estimator."""
    return fly_judged(
        "paper_5_free",
        {
            "plant.kind": "rigid_body_6dof",
            "communication.leader_links": case.leader_links,
            "gains.estimator.deadline_s": case.deadline_s,
            "gains.estimator.feed_forward": case.feed_forward,
            "timing.duration_s": duration_s,
        },
    )


def estimate_errors(one: JudgedFlight) -> Array:
    """Error (T, followers) [m] of the estimated position of the leader, from the second tick on."""
    track, leader = one.flight.track, one.uavs.index(one.scenario.leader.id)
    rows = [row for row in range(len(one.uavs)) if row != leader]
    off = track.estimate[1:, rows, :3] - track.odometry[1:, leader : leader + 1, :3]
    return np.asarray(np.linalg.norm(off, axis=2))


def worst_estimate_from(one: JudgedFlight, seconds: float) -> float:
    """Largest error of any follower's estimate from a time on [m]."""
    return float(estimate_errors(one)[one.times[1:] >= seconds].max())


def worst_estimate_after_tf2(one: JudgedFlight) -> float:
    """Largest error of any follower's estimate from the deadline of the estimator on [m]."""
    return worst_estimate_from(one, one.scenario.gains.estimator.deadline_s)


def estimator_claim(with_forward: JudgedFlight, without: JudgedFlight) -> Claim:
    """Every follower knows the leader from tf2 on, to the tolerance of the formation."""
    deadline_s = with_forward.scenario.gains.estimator.deadline_s
    ours = worst_estimate_from(with_forward, deadline_s)
    printed = worst_estimate_from(without, deadline_s)
    if printed <= TOLERANCE_M:
        verdict = HOLDS
    elif ours <= TOLERANCE_M:
        verdict = "holds when the leader's velocity is fed forward"
    else:
        verdict = FAILS
    return Claim(
        "estimator",
        "Every follower knows the leader's state from a time on that is chosen beforehand",
        "into a neighbourhood of zero, (48)",
        f"largest error after tf2 = {deadline_s:g} s: {1000 * printed:.0f} mm as printed, "
        f"{1000 * ours:.1f} mm with feed-forward (tolerance {1000 * TOLERANCE_M:.0f} mm)",
        verdict,
        "Fig. A1",
    )


def _figure(output: ExperimentFolder, flights: dict[EstimatorVariant, JudgedFlight]) -> Figure:
    drawing = style.figure(66)
    axes = drawing.add_subplot()
    curves: dict[str, Array] = {}
    for index, (case, one) in enumerate(flights.items()):
        shown = one.times[1:] <= _SHOWN_S
        times = one.times[1:][shown]
        worst = np.maximum(estimate_errors(one)[shown].max(axis=1), _FLOOR_M)
        label = f"{case.links}, {'with' if case.feed_forward else 'without'} feed-forward"
        axes.semilogy(times, worst, label=label, **style.line(index))
        curves = curves or time_column(times)
        curves[f"case{index + 1}_worst_error_m"] = worst
    for case in CASES[::2]:
        axes.axvline(case.deadline_s, color="black", linewidth=0.6)
    axes.set(xlabel="time after the epoch [s]", ylabel="worst error [m]")
    axes.set_xlim(0, _SHOWN_S)
    style.legend(drawing, axes, columns=1)
    caption = "Largest error of any follower's estimate of the leader's position; upright lines: deadlines tf2"
    return output.write_figure(Figure("fig_a1_estimator", "Fig. A1", caption), drawing, curves)


def _table(flights: dict[EstimatorVariant, JudgedFlight]) -> Table:
    links = {len(case.leader_links): case.links for case in flights}
    columns = (
        FlightColumn(
            "leader links", lambda one: links[len(one.scenario.communication.leader_links)]
        ),
        FlightColumn(
            "feed-forward", lambda one: "on" if one.scenario.gains.estimator.feed_forward else "off"
        ),
        FlightColumn("λmin(H)", lambda one: one.scenario.topology.lambda_min, 3),
        FlightColumn("tf2, s", lambda one: one.scenario.gains.estimator.deadline_s, 1),
        FlightColumn("largest error after tf2, m", worst_estimate_after_tf2, 4),
        col.MET,
        col.ERROR_AT_5_S._replace(title="formation error at 5 s, m"),
        col.LARGEST_AFTER,
        col.LARGEST_AFTER_ALL,
    )
    return flights_table(
        "estimator",
        "The estimator with and without feed-forward",
        columns,
        flights.values(),
        "Without feed-forward (44) trails the moving leader by its speed over the gain, and the formation task "
        "passes that on. With one link λmin is small: the gain that an early deadline of the estimator would need "
        "is more than a period of 10 ms allows, and the formation misses its own.",
    )


def run(output: ExperimentFolder) -> ExperimentResult:
    """Fly the four estimators."""
    flights = {}
    for case in CASES:
        output.progress(f"flying: {case.links}, feed-forward {case.feed_forward}")
        flights[case] = flight(case)
    return ExperimentResult(
        "estimator",
        "The leader estimator",
        "Scenario `paper_5_free` on the six-input plant, profile `soft`, 30 s.",
        figures=(_figure(output, flights),),
        tables=(_table(flights),),
        claims=(estimator_claim(flights[CASES[0]], flights[CASES[1]]),),
    )
