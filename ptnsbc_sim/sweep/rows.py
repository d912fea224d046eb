"""The table of a sweep: one row for each UAV and flight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.swarm import HeadlessFlight, fly
from ptnsbc_sim.sweep.plan import SweepPlan, Value, drawn_scenario
from ptnsbc_sim.verdict import Recording, Separation, Verdict, verdict_on
from ptnsbc_sim.verdict.headless import recording_of
from ptnsbc_sim.verdict.recording import counter_rise


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
    closest_obstacle_m: (
        float | None
    )  # beyond its keep-out sphere, negative inside; None: no obstacle
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
    words = {
        "draw": draw,
        "uav": 0,
        "slot": 0,
        "verdict": NOT_FLOWN,
        "cause": " ".join(cause.split()),
    }
    blank = dict.fromkeys(field.name for field in fields(SweepRow))
    return SweepRow(**{**blank, **words, "flight_verdict": NOT_FLOWN, "check": ""})  # type: ignore[arg-type]


def fly_draw(
    plan: SweepPlan, k: int, room: HeadlessFlight | None = None, check: str = ""
) -> tuple[list[SweepRow], Mapping[str, Value], HeadlessFlight]:
    """Fly draw k of a plan.

    Args:
        plan: the sweep.
        k: number of the draw.
        room: an earlier flight, which is overwritten.
        check: what the dry run before the flight said, for the rows.

    Returns:
        The rows of its UAVs, what was drawn, and the flight as room for the next one.
    """
    scenario, values = drawn_scenario(plan, k)
    flight = fly(scenario, room=room)
    return rows_of(k, scenario, recording_of(flight), check), values, flight


def rows_of(draw: int, scenario: Scenario, recording: Recording, check: str = "") -> list[SweepRow]:
    """The rows of one flight; `check` is what the dry run before it said."""
    verdict = verdict_on(recording)
    efforts = {one.uav: one for one in verdict.efforts}
    near = _nearest(scenario, verdict)
    rows = []
    for one in verdict.uavs:
        counters = recording.counters[one.uav]
        begin_ns, end_ns = recording.start_ns, recording.end_ns
        room = near[one.uav]
        rows.append(
            SweepRow(
                draw=draw,
                uav=one.uav,
                slot=one.slot,
                verdict=one.verdict,
                cause=one.reason,
                flight_verdict=verdict.verdict,
                deadline_s=float(one.deadline_s),
                start_error_m=one.start_error_m,
                tolerance_m=one.tolerance_m,
                band_m=one.band_m,
                settling_s=one.settling_s,
                error_at_deadline_m=one.error_at_deadline_m,
                largest_after_m=one.max_error_after_m,
                largest_after_all_m=one.max_error_after_all_m,
                rmse_after_m=one.rmse_after_m,
                encounter_s=one.encounter_s,
                excused_outside_s=one.excused_outside_s,
                regained_s=one.regained_s,
                recovery_s=one.recovery_s,
                avoidance_s=counter_rise(counters, "avoidance_active_s", begin_ns, end_ns),
                deadlock_s=counter_rise(counters, "deadlock_s", begin_ns, end_ns),
                saturated_s=one.saturated_s,
                holding_s=one.holding_s,
                closest_uav_m=room.uav_m,
                closest_obstacle_m=room.obstacle_m,
                inside_keep_out_s=room.inside_s,
                peak_force_n=efforts[one.uav].peak_force_n,
                energy_n2_s=efforts[one.uav].energy,
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

    def take(self, pair: Separation, *, obstacle: bool) -> None:
        """One of its pairs."""
        self.inside_s += pair.inside_s
        if obstacle:
            room = pair.distance_m - pair.keep_out_m
            self.obstacle_m = min(inf if self.obstacle_m is None else self.obstacle_m, room)
        else:
            self.uav_m = min(inf if self.uav_m is None else self.uav_m, pair.distance_m)


def _nearest(scenario: Scenario, verdict: Verdict) -> dict[int, _Room]:
    found = {f"uav{uav}": _Room() for uav in scenario.uav_ids}
    obstacles = {one.name for one in scenario.world.bodies}
    for pair in verdict.separations:
        of_obstacle = pair.second in obstacles
        found[pair.first].take(pair, obstacle=of_obstacle)
        if not of_obstacle:
            found[pair.second].take(pair, obstacle=False)
    return {int(name.removeprefix("uav")): room for name, room in found.items()}
