"""The safety state of a UAV process, by what it notices.

A follower whose parent or leader is silent holds by the law itself, which keeps it clear meanwhile. A UAV without its
own odometry sends no setpoint, because a setpoint is the proof of life for its vehicle.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from ptnsbc_nodes.comm.diagnostics import Concern, DiagnosticLevel, SafetyState


class PlannerSight(NamedTuple):
    """The observations of a UAV process on its inputs and its flight; an empty text says that nothing is wrong."""

    holding: bool = False
    inactive: bool = False
    odometry_stale: bool = False
    slots_fault: str = ""  # why it does not know its slot
    deadlock: bool = False  # it climbs out of one
    near_stale: bool = False
    silent_estimates: str = ""  # UAVs whose estimates of the leader are left out
    clock_offset: str = ""
    intruder: str = ""  # refused messages, or a second publisher
    missed_ticks: int = 0  # since the last status
    waiting_for: str = ""
    flying: bool = True  # a leg has been announced


def planner_concerns(sight: PlannerSight) -> Iterator[Concern]:
    """The reasons for the safety state of a UAV process."""
    error, warn = DiagnosticLevel.ERROR, DiagnosticLevel.WARN
    if sight.inactive:  # it was told to be: nothing else of it counts
        yield Concern(SafetyState.STOP, warn, "inactive")
        return
    if sight.odometry_stale:
        yield Concern(SafetyState.STOP, error, "own odometry is stale: no setpoints")
    if sight.slots_fault:
        yield Concern(SafetyState.HOLD_CLEAR, error, sight.slots_fault)
    elif sight.holding:
        yield Concern(SafetyState.HOLD_CLEAR, warn, "holding")
    missed = sight.missed_ticks
    for reason in (  # in spite of which the UAV flies on
        sight.clock_offset,
        "deadlock: avoidance leaves no way to the place" if sight.deadlock else "",
        "near objects are stale: slow" if sight.near_stale else "",
        f"estimates left out: {sight.silent_estimates}" if sight.silent_estimates else "",
        sight.intruder,
        f"{missed} ticks missed since the last status" if missed > 0 else "",
    ):
        if reason:
            yield Concern(SafetyState.DEGRADED, warn, reason)
    if sight.waiting_for:
        state = SafetyState.DEGRADED if sight.flying else SafetyState.NOMINAL
        yield Concern(state, warn, f"waiting for {sight.waiting_for}")
