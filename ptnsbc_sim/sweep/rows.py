"""The table of a sweep: one row for each UAV and flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import inf
from typing import Any

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.swarm import HeadlessFlight, fly
from ptnsbc_sim.sweep.plan import SweepPlan, Value, drawn_scenario
from ptnsbc_sim.verdict import Recording, Verdict, verdict_on
from ptnsbc_sim.verdict.recording import counter_rise, recording_of


@dataclass(frozen=True)
class SweepRow:
    """The figures of one UAV in one flight; times in seconds after the start, None: there is no such figure."""

    draw: int
    uav: int  # 0 of a draw that was not flown
    slot: int  # its place in the formation, by the number of the UAV to which the scenario gives it
    verdict: str  # met | missed | violated | void | not flown
    cause: str  # why not met, empty when met
    flight_verdict: str  # the worst of the flight's UAVs: violated, missed, void, met
    deadline_s: float | None
    start_error_m: float | None
    tolerance_m: float | None
    band_m: float | None
    settling_s: float | None  # None: the error ends outside the band
    error_at_deadline_m: float | None
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


_UNITS = {"_n2_s": "N^2 s", "_m": "m", "_s": "s", "_n": "N"}

UNITS: dict[str, str] = {
    field.name: next((unit for end, unit in _UNITS.items() if field.name.endswith(end)), "")
    for field in fields(SweepRow)
}
"""Unit of each column; empty for words and numbers without one."""


NOT_FLOWN = "not flown"


def not_flown(draw: int, cause: str) -> SweepRow:
    """The row of a draw that cannot be flown."""
    blank: dict[str, Any] = dict.fromkeys(field.name for field in fields(SweepRow))
    words = {"verdict": NOT_FLOWN, "flight_verdict": NOT_FLOWN, "cause": " ".join(cause.split())}
    return SweepRow(**blank | words | {"draw": draw, "uav": 0, "slot": 0, "check": ""})


def fly_draw(
    plan: SweepPlan, k: int, room: HeadlessFlight | None = None, check: str = ""
) -> tuple[list[SweepRow], Mapping[str, Value], HeadlessFlight]:
    """The rows of draw k, flown, what was drawn, and the flight as `room` for the next one, which overwrites it."""
    scenario, values = drawn_scenario(plan, k)
    flight = fly(scenario, room=room)
    return rows_of(k, scenario, recording_of(flight), check), values, flight


_OF_VERDICT = {
    "cause": "reason",
    "largest_after_m": "max_error_after_m",
    "largest_after_all_m": "max_error_after_all_m",
}
"""Columns that have another name in the verdict."""


def rows_of(draw: int, scenario: Scenario, recording: Recording, check: str = "") -> list[SweepRow]:
    """The rows of one flight; `check` is what the dry run before it said."""
    verdict = verdict_on(recording)
    efforts = {effort.uav: effort for effort in verdict.efforts}
    near, span_ns = _nearest(scenario, verdict), (recording.start_ns, recording.end_ns)
    rows = []
    for of in verdict.uavs:
        values: dict[str, Any] = {
            field.name: getattr(of, _OF_VERDICT.get(field.name, field.name), None)
            for field in fields(SweepRow)
        }
        rows.append(
            replace(
                SweepRow(**values),
                draw=draw,
                flight_verdict=verdict.verdict,
                deadline_s=float(of.deadline_s),
                avoidance_s=counter_rise(recording, of.uav, "avoidance_active_s", *span_ns),
                deadlock_s=counter_rise(recording, of.uav, "deadlock_s", *span_ns),
                closest_uav_m=near[of.uav].uav_m,
                closest_obstacle_m=near[of.uav].obstacle_m,
                inside_keep_out_s=near[of.uav].inside_s,
                peak_force_n=efforts[of.uav].peak_force_n,
                energy_n2_s=efforts[of.uav].energy,
                check=check,
            )
        )
    return rows


@dataclass
class _Room:
    """The least distances of one UAV to others."""

    uav_m: float | None = None
    obstacle_m: float | None = None
    inside_s: float = 0.0


def _nearest(scenario: Scenario, verdict: Verdict) -> dict[int, _Room]:
    rooms = {f"uav{uav}": _Room() for uav in scenario.uav_ids}
    for pair in verdict.separations:
        for name in (pair.first, pair.second):
            if name not in rooms:
                continue  # an obstacle
            room = rooms[name]
            room.inside_s += pair.inside_s
            if pair.second in rooms:
                room.uav_m = min(inf if room.uav_m is None else room.uav_m, pair.distance_m)
            else:
                beyond_m = pair.distance_m - pair.keep_out_m
                room.obstacle_m = min(inf if room.obstacle_m is None else room.obstacle_m, beyond_m)
    return {int(name.removeprefix("uav")): room for name, room in rooms.items()}
