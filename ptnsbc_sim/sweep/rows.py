"""The table of a sweep: one row for each UAV and flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.fields import unit_of
from ptnsbc_sim.swarm import HeadlessFlight, fly
from ptnsbc_sim.sweep.plan import SweepPlan, Value, drawn_scenario
from ptnsbc_sim.verdict import Recording, verdict_on
from ptnsbc_sim.verdict.deadline import UavVerdict
from ptnsbc_sim.verdict.recording import counter_rises, recording_of


@dataclass(frozen=True)
class SweepRow:
    """The figures of one UAV in one flight; times in seconds after the start, None: there is no such figure."""

    draw: int
    uav: int  # 0 of a draw that was not flown
    slot: int  # its place in the formation, by the number of the UAV to which the scenario gives it
    verdict: str  # met | met late | missed | violated | void | not flown
    cause: str  # why not met, or why late; empty when met
    flight_verdict: str  # the worst of the flight's UAVs: violated, missed, void, met late, met
    deadline_s: float | None
    start_error_m: float | None
    tolerance_m: float | None
    band_m: float | None
    settling_s: float | None  # None: the error ends outside the band
    error_at_deadline_m: float | None
    # at the deadline, whatever excuses it; None: not expected then, by the plan
    in_place: bool | None
    arrived_s: float | None  # of a UAV that kept its promise, and came later than the deadline
    gave_way_to: str  # why it was not in place: UAVs and obstacles, separated by commas
    largest_after_m: float | None  # after the deadline, outside encounters
    largest_after_all_m: float | None  # after the deadline, inside encounters too
    rmse_after_m: float | None  # after the deadline, outside encounters
    encounter_s: float | None  # time inside encounters, which excuse the error
    excused_outside_s: float | None  # of it: after the deadline and outside the band
    regained_s: float | None  # longest time from the end of an encounter until back in its place
    recovery_s: float | None  # the promise for it
    avoidance_s: float | None  # time in which the avoidance changed the velocity
    deadlock_s: float | None  # time in deadlocks, with no way left by the avoidance
    saturated_s: float | None  # until the deadline
    holding_s: float | None  # until the deadline
    closest_uav_m: float | None  # between centres; None: no other UAV
    closest_obstacle_m: float | None  # beyond its keep-out, negative inside; None: no obstacle
    inside_keep_out_s: float | None  # of UAVs and obstacles, summed
    peak_force_n: float | None
    energy_n2_s: float | None  # integral of |u|^2 (54)
    check: str  # what the dry run before the flight said: accepted | refused; empty: there was none
    keep_out_margin: float | None = None  # least (distance - keep-out) / keep-out
    # (tolerance - error at it) / tolerance; None: it gave way, or was not expected
    deadline_margin: float | None = None
    return_margin: float | None = None  # (promise - time back after an encounter) / promise


MARGINS = ("keep_out_margin", "deadline_margin", "return_margin")
"""Columns that are below 0 where a promise is broken; what a search makes small."""

UNITS = {field.name: unit_of(field.name) or "" for field in fields(SweepRow)}
"""Unit of each column; empty for words and numbers without one."""


NOT_FLOWN = "not flown"


def not_flown(draw: int, cause: str) -> SweepRow:
    """The row of a draw that cannot be flown."""
    blank: dict[str, Any] = dict.fromkeys(field.name for field in fields(SweepRow))
    words = {"verdict": NOT_FLOWN, "flight_verdict": NOT_FLOWN, "cause": " ".join(cause.split())}
    none = {"uav": 0, "slot": 0, "gave_way_to": "", "check": ""}
    return SweepRow(**blank | words | none | {"draw": draw})


def fly_draw(
    plan: SweepPlan, k: int, room: HeadlessFlight | None = None, check: str = ""
) -> tuple[list[SweepRow], Mapping[str, Value], HeadlessFlight]:
    """The rows of draw k, flown, what was drawn, and the flight as `room` for the next one, which overwrites it."""
    scenario, values = drawn_scenario(plan, k)
    flight = fly(scenario, room=room)
    return rows_of(k, scenario, recording_of(flight), check), values, flight


def _left(used: float | None, promised: float | None) -> float | None:
    """The share of a promise that is left."""
    return None if used is None or not promised else 1.0 - used / promised


_OF_VERDICT = {name: name for name in UNITS if name in UavVerdict.__dataclass_fields__} | {
    "cause": "reason",
    "largest_after_m": "max_error_after_m",
    "largest_after_all_m": "max_error_after_all_m",
}
"""Columns that are figures of the verdict, and their names there."""

_figures_of = attrgetter(*_OF_VERDICT.values())


def rows_of(draw: int, scenario: Scenario, recording: Recording, check: str = "") -> list[SweepRow]:
    """The rows of one flight; `check` is what the dry run before it said."""
    verdict = verdict_on(recording)
    efforts = {effort.uav: effort for effort in verdict.efforts}
    rises = counter_rises(recording, recording.start_ns, recording.end_ns)
    names, rows, worst = {f"uav{uav}" for uav in scenario.uav_ids}, [], verdict.verdict
    for of in verdict.uavs:
        pairs = [p for p in verdict.separations if f"uav{of.uav}" in (p.first, p.second)]
        to_uavs = (p.distance_m for p in pairs if p.second in names)
        to_obstacles = (p.distance_m - p.keep_out_m for p in pairs if p.second not in names)
        values = dict(zip(_OF_VERDICT, _figures_of(of), strict=True))
        values |= {
            "draw": draw,
            "flight_verdict": worst,
            "deadline_s": float(of.deadline_s),
            "gave_way_to": ",".join(of.gave_way_to),
            "avoidance_s": rises[of.uav]["avoidance_active_s"],
            "deadlock_s": rises[of.uav]["deadlock_s"],
            "closest_uav_m": min(to_uavs, default=None),
            "closest_obstacle_m": min(to_obstacles, default=None),
            "inside_keep_out_s": sum((p.inside_s for p in pairs), 0.0),
            "peak_force_n": efforts[of.uav].peak_force_n,
            "energy_n2_s": efforts[of.uav].energy,
            "check": check,
            "keep_out_margin": min(
                (p.distance_m / p.keep_out_m - 1.0 for p in pairs if p.keep_out_m > 0.0),
                default=None,
            ),
            "deadline_margin": _left(of.error_at_deadline_m, of.tolerance_m)
            if of.in_place is not None and not of.gave_way_to
            else None,
            "return_margin": _left(of.regained_s, of.recovery_s),
        }
        rows.append(SweepRow(**values))
    return rows
