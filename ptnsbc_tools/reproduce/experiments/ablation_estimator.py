"""Ours, taken apart: the leader estimator with and without the leader's velocity fed forward."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_tools.reproduce.claims import FAILS, HOLDS
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder, times_column
from ptnsbc_tools.reproduce.experiment_result import Claim, Column, ExperimentResult, Figure, Table
from ptnsbc_tools.reproduce.figures import style
from ptnsbc_tools.reproduce.flights import JudgedFlight, flown
from ptnsbc_tools.verdict.tolerances import TOLERANCE_M

_SHOWN_S = 15.0
_FLOOR_M = 1e-6


class EstimatorVariant(NamedTuple):
    """One estimator: who hears the leader, tf2, and whether its velocity is fed forward."""

    links: str
    leader_links: tuple[int, ...]
    deadline_s: float
    feed_forward: bool

    @property
    def label(self) -> str:
        """For legends."""
        return f"{self.links}, {'with' if self.feed_forward else 'without'} feed-forward"


# One link makes lambda_min small: with tf2 = 1.5 s the gain would be too large for a period of 10 ms.
CASES = tuple(
    EstimatorVariant(links, heard, deadline_s, forward)
    for links, heard, deadline_s in (
        ("all hear the leader", (2, 3, 4, 5), 1.5),
        ("only UAV 2 does", (2,), 3.0),
    )
    for forward in (True, False)
)


def flight(case: EstimatorVariant, duration_s: float = 30.0) -> JudgedFlight:
    """`paper_5_free` on the six-input plant, profile `soft`, with another estimator."""
    return flown(
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
    track, leader = one.flight.track, one.scenario.uav_ids.index(one.scenario.leader_id)
    rows = [row for row in range(len(one.scenario.uav_ids)) if row != leader]
    off = track.estimate[1:, rows, :3] - track.odometry[1:, leader : leader + 1, :3]
    return np.asarray(np.linalg.norm(off, axis=2))


def worst_from(one: JudgedFlight, seconds: float) -> float:
    """Largest error of any follower from a time on [m]."""
    return float(estimate_errors(one)[one.times[1:] >= seconds].max())


def estimator_claim(with_forward: JudgedFlight, without: JudgedFlight) -> Claim:
    """Everybody knows the leader from tf2 on, to the tolerance of the formation."""
    deadline_s = with_forward.scenario.gains.estimator.deadline_s
    ours, printed = worst_from(with_forward, deadline_s), worst_from(without, deadline_s)
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


def _figure(workshop: ExperimentFolder, flights: dict[EstimatorVariant, JudgedFlight]) -> Figure:
    made = style.figure(66)
    axes = made.add_subplot()
    sheet: dict[str, Array] = {}
    for index, (case, one) in enumerate(flights.items()):
        shown = one.times[1:] <= _SHOWN_S
        times = one.times[1:][shown]
        worst = np.maximum(estimate_errors(one)[shown].max(axis=1), _FLOOR_M)
        axes.semilogy(times, worst, label=case.label, **style.look(index))
        sheet.setdefault("time_s", times_column(times))
        sheet[f"case{index + 1}_worst_error_m"] = worst
    for case in CASES[::2]:
        axes.axvline(case.deadline_s, color="black", linewidth=0.6)
    axes.set(xlabel="time after the epoch [s]", ylabel="worst error [m]")
    axes.set_xlim(0, _SHOWN_S)
    style.legend(made, axes, columns=1)
    name = "fig_a1_estimator"
    workshop.figure(name, made, sheet)
    caption = "Largest error of any follower's estimate of the leader's position; upright lines: deadlines tf2"
    return Figure(name, "Fig. A1", caption)


def _table(flights: dict[EstimatorVariant, JudgedFlight]) -> Table:
    rows = tuple(
        (
            case.links,
            "on" if case.feed_forward else "off",
            one.scenario.topology.lambda_min,
            case.deadline_s,
            worst_from(one, case.deadline_s),
            f"{one.met()} of {len(one.verdict.uavs)}",
            one.worst_at_deadline_m(),
            one.worst_after_m(),
        )
        for case, one in flights.items()
    )
    return Table(
        "ablation_estimator",
        "The estimator with and without feed-forward",
        (
            Column("leader links"),
            Column("feed-forward"),
            Column("λmin(H)", 3),
            Column("tf2, s", 1),
            Column("largest error after tf2, m", 4),
            Column("deadline met"),
            Column("formation error at 5 s, m", 4),
            Column("largest after, m", 4),
        ),
        rows,
        "Without feed-forward (44) trails the moving leader by its speed over the gain, and the formation task "
        "passes that on. With one link λmin is small: the gain that an early deadline of the estimator would need "
        "is more than a period of 10 ms allows, and the formation misses its own.",
    )


def run(workshop: ExperimentFolder) -> ExperimentResult:
    """Fly the four estimators."""
    flights = {}
    for case in CASES:
        workshop.tell(f"flying: {case.label}")
        flights[case] = flight(case)
    return ExperimentResult(
        "ablation_estimator",
        "Ablation: the leader estimator",
        "Scenario `paper_5_free` on the six-input plant, profile `soft`, 30 s.",
        figures=(_figure(workshop, flights),),
        tables=(_table(flights),),
        claims=(estimator_claim(flights[CASES[0]], flights[CASES[1]]),),
    )
