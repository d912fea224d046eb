"""One UAV on ROS 2: bytes in, one control step per tick, bytes out. Its clock says when a tick is due."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ptnsbc_core.nanoseconds import nanoseconds
from ptnsbc_io.wire import HeaderFields
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import decode_leg
from ptnsbc_nodes.comm.diagnostics import (
    SAFETY,
    Concern,
    DiagnosticLevel,
    SafetyState,
    StatusPublisher,
    assess,
    readiness,
)
from ptnsbc_nodes.comm.drawing import publish_description
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.uav.clocks import LockstepClock, RealTimeClock, UavClock
from ptnsbc_nodes.uav.leg_services import LegServices
from ptnsbc_nodes.uav.uav_controller import UavFlight
from ptnsbc_nodes.uav.uav_topics import Outbox, Subscriptions, follow_setpoints
from ptnsbc_sim.counters import STATUS_HZ
from ptnsbc_sim.scenario import Scenario

ABANDONED_S = 30.0
"""A UAV that no launcher watches ends when the process of its vehicle has been gone for so long."""


class PlannerSight(NamedTuple):
    """The observations of a UAV process on its inputs and its flight; an empty text says that nothing is wrong."""

    holding: bool = False
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
    """The reasons for the safety state of a UAV process.

    A follower whose parent or leader is silent holds by the law itself, which keeps it clear meanwhile. A UAV without
    its own odometry sends no setpoint, because a setpoint is the proof of life for its vehicle.
    """
    error, warn = DiagnosticLevel.ERROR, DiagnosticLevel.WARN
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


class UavNode:
    """The controller of one UAV: one rclpy node, one tick; it only listens until `start`."""

    def __init__(
        self,
        node: Node,
        scenario: Scenario,
        uav_id: int,
        edges: CommunicationGraph,
        on_abandoned: Callable[[], None] = lambda: None,
    ) -> None:
        """`on_abandoned` is called when the vehicle of the UAV is gone for good."""
        self.node = node
        self._recorded = edges.options.recorded
        self._on_abandoned = on_abandoned
        self._vehicle_seen_s: float | None = None
        lockstep = edges.options.lockstep
        # In lock-step any message may be the last that a tick waits for.
        after = self._advance if lockstep else lambda: None
        self.endpoints = Endpoints(node, lockstep, edges.options.seal, after)
        self._clock: UavClock = (
            LockstepClock(scenario) if lockstep else RealTimeClock(node, scenario)
        )
        self.flight = UavFlight(scenario, uav_id, edges)
        self._outbox = Outbox(self.endpoints, edges, self.flight)
        self._heard = Subscriptions(node, self.endpoints, edges, self.flight, self._clock)
        self.endpoints.listen(topics.EPOCH, decode_leg, self._on_leg)
        publish_description(self.endpoints, scenario, uav_id)
        name, recorders = f"uav{uav_id}: planner", edges.options.recorders
        self._status = StatusPublisher(node, self.endpoints, name, recorders)
        self._reported_missed = 0
        self._leg_services = self._services(edges)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(1.0 / STATUS_HZ, self._on_status_timer, clock=steady)
        if not self._clock.lockstep:
            self.endpoints.last_word = lambda: self._report(self._clock.now_ns())

    @property
    def begun(self) -> bool:
        """True if a leg has been announced."""
        return self.flight.epochs.announced

    def start(self) -> None:
        """Begin to tick."""
        self._clock.start(self._advance)

    def waiting_for(self) -> list[str]:
        """Topics without their other end; in real time also an odometry that has not arrived yet.

        Before the first leg a recorded topic waits for its recorder. In flight a recorder or a child that
        ends is no reason to wait.
        """
        missing, early = self.endpoints.unheard(), not self.begun
        if early:
            missing += self.endpoints.contested()
        if self._clock.lockstep:
            return missing + self.endpoints.unread()
        if self._recorded and early:
            missing += self.endpoints.unread()
            if self._leg_services is not None:
                missing += self._leg_services.missing_listeners()
        if self.flight.inbox.own is None and self._heard.odom_name not in missing:
            missing.append(self._heard.odom_name)
        if early:
            missing += [name for name in self._heard.unknown_positions() if name not in missing]
            if self._clock.offset:
                missing.append(f"another time: {self._clock.offset}")
        return missing

    def look_for_vehicle(self, now_s: float) -> None:
        """Notice that the vehicle's process, which was there, has been gone for `ABANDONED_S`."""
        if self._heard.odom_name not in self.endpoints.unheard():
            self._vehicle_seen_s = now_s
        elif self._vehicle_seen_s is not None and now_s - self._vehicle_seen_s > ABANDONED_S:
            self._on_abandoned()

    def _waiting_to_start(self) -> list[str]:
        """The things for which a leg in formation waits: with open slots, positions too."""
        return [*dict.fromkeys((*self.waiting_for(), *self._heard.unknown_positions()))]

    def _services(self, edges: CommunicationGraph) -> LegServices | None:
        """The services of the leader, which a successor serves when it leads; None for all others."""
        flight, scenario = self.flight, self.flight.scenario
        leads = flight.uav == scenario.leader.id
        if scenario.formation.reconfigures:
            self.endpoints.shared.add(topics.EPOCH.name)
        if leads and scenario.takes_setpoints:
            follow_setpoints(self.endpoints, edges.options.recorders, flight.epochs, self._clock)
        succeeds = scenario.formation.reconfigures and flight.uav in scenario.leader.successors
        if not (leads or succeeds):
            return None
        services = LegServices(
            self.node, self.endpoints, edges, flight, self._clock, self._waiting_to_start
        )
        if leads:
            services.serve()
        return services

    def _on_leg(self, leg: HeaderFields) -> None:
        is_new = self.flight.take_leg(leg)
        if is_new and self._leg_services is not None:
            self._leg_services.keep(leg)
        self._clock.align(self.flight.inbox.own)

    def _advance(self) -> None:
        """Do the tick if one is due."""
        at = self._clock.due(self.flight)
        if at is None:
            return
        step = self.flight.step(at, self._clock.cutoff_ns(at))
        if not step.at.flying:  # not announced or still to come
            self._clock.pace.missed = 0
        status_due = self._clock.done(at)
        self._outbox.send(step)
        if self._leg_services is not None and step.at.flying:
            self._leg_services.follow(self.flight.controller)
        if status_due:
            self._report(at.now_ns)

    def _on_status_timer(self) -> None:
        self.look_for_vehicle(time.monotonic())
        stamp_ns = self._clock.status_ns()
        if stamp_ns is not None:
            self._report(stamp_ns)

    def _report(self, stamp_ns: int) -> None:
        """Publish the status at an instant of the flight; -1 is outside of the flight."""
        flight, clock, controller = self.flight, self._clock, self.flight.controller
        missing = self.waiting_for() if stamp_ns < 0 or not clock.lockstep else []
        flying, leg = self.begun, flight.leg(stamp_ns)
        missed = clock.pace.missed - self._reported_missed
        self._reported_missed = clock.pace.missed
        silent: list[int] = []
        if flying and not clock.lockstep:
            stale_ns = nanoseconds(controller.config.stale_s)
            silent = flight.inbox.silent_estimates(stamp_ns, stale_ns)
        sight = PlannerSight(
            holding=flying and controller.counters.holding,
            odometry_stale=not clock.lockstep and controller.odometry_stale(stamp_ns),
            slots_fault=flight.slots_fault(leg),
            deadlock=flying and controller.counters.deadlock,
            near_stale=flying and controller.near_stale,
            silent_estimates=" ".join(f"uav{i}" for i in silent),
            clock_offset=clock.offset,
            intruder=self.endpoints.warning(),
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
            **self.endpoints.refusals.values(),
        }
        self._status.publish(stamp_ns, safety.level, safety.reason, values)
