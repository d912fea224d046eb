"""The status that a UAV process publishes, and its safety state.

A follower whose parent or leader is silent holds by the law itself, which keeps it clear meanwhile. A UAV without its
own odometry sends no setpoint, because a setpoint is the proof of life for its vehicle.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from rclpy.node import Node

from ptnsbc_nodes.comm.diagnostics import (
    SAFETY,
    Concern,
    DiagnosticLevel,
    SafetyState,
    StatusPublisher,
    assess,
    readiness,
)
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import FlightOptions
from ptnsbc_nodes.uav.clocks import UavClock
from ptnsbc_nodes.uav.uav_flight import UavFlight


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


class UavStatus:
    """The status of one UAV: on /diagnostics, and in lock-step before and between ticks on /formation/ready."""

    def __init__(
        self,
        endpoints: Endpoints,
        node: Node,
        flight: UavFlight,
        clock: UavClock,
        options: FlightOptions,
    ) -> None:
        self._endpoints, self._flight, self._clock = endpoints, flight, clock
        name = f"uav{flight.uav}: planner"
        self._status = StatusPublisher(node, endpoints, name, options.recorders)
        self._reported_missed = 0

    def publish(self, stamp_ns: int, missing: Sequence[str], active: bool) -> None:
        """Publish the status at an instant of the flight, -1 outside of it; `missing`: what the UAV waits for."""
        flight, clock, controller = self._flight, self._clock, self._flight.controller
        flying, leg = flight.epochs.announced, flight.leg(stamp_ns)
        missed = clock.pace.missed - self._reported_missed
        self._reported_missed = clock.pace.missed
        silent: list[int] = []
        if flying and not clock.lockstep:
            stale_ns = round(controller.config.stale_s * 1e9)
            silent = flight.inbox.silent_estimates(stamp_ns, stale_ns)
        sight = PlannerSight(
            holding=flying and controller.counters.holding,
            inactive=not active,
            odometry_stale=not clock.lockstep and controller.odometry_stale(stamp_ns),
            slots_fault=flight.slots_fault(leg),
            deadlock=flying and controller.counters.deadlock,
            near_stale=flying and controller.near_stale,
            silent_estimates=" ".join(f"uav{i}" for i in silent),
            clock_offset=clock.offset,
            intruder=self._endpoints.warning(),
            missed_ticks=missed,
            waiting_for=", ".join(missing),
            flying=flying,
        )
        safety = assess(planner_concerns(sight))
        values = {
            **readiness(missing),
            "mode": leg.name if leg else "waiting",
            SAFETY: safety.state.text,
            "missed_ticks": str(clock.pace.missed),
            **controller.counters.values(),
            **self._endpoints.refusals.values(),
        }
        if flight.faults.injected:
            values["injected"] = "; ".join(flight.faults.injected)
        self._status.publish(stamp_ns, safety.level, safety.reason, values)
