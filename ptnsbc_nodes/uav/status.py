"""The status that a UAV process publishes, and the notice that the process of its vehicle is gone."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.diagnostics import (
    SAFETY,
    STATUS_HZ,
    StatusLog,
    assess,
    diagnostics,
    readiness,
)
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import FlightOptions
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.comm.topics import READY
from ptnsbc_nodes.uav.controller import UavController
from ptnsbc_nodes.uav.faults import UavFaults
from ptnsbc_nodes.uav.safety import PlannerSight, planner_concerns
from ptnsbc_nodes.uav.slots import OpenSlots
from ptnsbc_nodes.uav.timing import UavTiming

ABANDONED_S = 30.0
"""A UAV that no launcher watches ends when the process of its vehicle has been gone for so long."""


class VehiclePresence:
    """Notices that a vehicle's process, which was there, has been gone for `ABANDONED_S`."""

    def __init__(self, on_abandoned: Callable[[], None]) -> None:
        self._on_abandoned = on_abandoned
        self._seen_s: float | None = None

    def look(self, present: bool, now_s: float) -> None:
        """Take note of whether the process is there."""
        if present:
            self._seen_s = now_s
        elif self._seen_s is not None and now_s - self._seen_s > ABANDONED_S:
            self._on_abandoned()


class UavParts(NamedTuple):
    """The parts of a UAV process that its status is about."""

    uav: int
    options: FlightOptions
    endpoints: Endpoints
    epochs: Epochs
    timing: UavTiming
    controller: UavController
    faults: UavFaults
    slots: OpenSlots | None
    is_active: Callable[[], bool]
    waiting_for: Callable[[], list[str]]
    look_for_vehicle: Callable[[float], None]


class StatusPublisher:
    """The status of one UAV: on /diagnostics, and in lock-step before and between ticks on /formation/ready."""

    def __init__(self, node: Node, parts: UavParts) -> None:
        self._node = node
        self._parts = parts
        self._send = parts.endpoints.publisher(topics.DIAGNOSTICS, parts.options.recorders)
        self._send_ready = parts.endpoints.publisher(READY, 0)
        self._log = StatusLog(node)
        self._seen_done_ns = -1
        self._reported_missed = 0
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(1.0 / STATUS_HZ, self._on_timer, clock=steady)
        if not parts.options.lockstep:
            parts.endpoints.last_word = lambda: self.publish(parts.timing.now_ns())

    def close(self) -> None:
        """Remove the timer from the node."""
        self._node.destroy_timer(self._timer)

    def _on_timer(self) -> None:
        timing = self._parts.timing
        self._parts.look_for_vehicle(time.monotonic())
        if not self._parts.options.lockstep:
            self.publish(timing.now_ns())
        elif timing.done_ns in (-1, self._seen_done_ns):
            # The flight has not begun, or the UAV waits for others: the launcher learns that it is alive.
            self.publish(-1)
        self._seen_done_ns = timing.done_ns

    def publish(self, stamp_ns: int) -> None:
        """Publish the status at an instant of the flight; -1 is outside of the flight."""
        parts = self._parts
        missing = parts.waiting_for() if stamp_ns < 0 or not parts.options.lockstep else []
        leg = parts.epochs.at(stamp_ns, parts.uav)
        safety = assess(planner_concerns(self._sight(stamp_ns, missing)))
        values = {
            **readiness(missing),
            "mode": leg.name if leg else "waiting",
            SAFETY: safety.state.text,
            "missed_ticks": str(parts.timing.pace.missed),
            **parts.controller.counters.values(),
            **parts.endpoints.refusals.values(),
        }
        if parts.faults.injected:
            values["injected"] = "; ".join(parts.faults.injected)
        self._log.note(safety.level, safety.reason)
        send = self._send if stamp_ns >= 0 else self._send_ready
        name, (_, level, reason) = f"uav{parts.uav}: planner", safety
        send(diagnostics(max(stamp_ns, 0), name, level, reason, values))

    def _sight(self, stamp_ns: int, missing: list[str]) -> PlannerSight:
        parts, lockstep = self._parts, self._parts.options.lockstep
        flying, controller = parts.epochs.announced, parts.controller
        leg = parts.epochs.at(stamp_ns, parts.uav)
        total = parts.timing.pace.missed
        missed, self._reported_missed = total - self._reported_missed, total
        silent = () if lockstep or not flying else controller.silent_estimates(stamp_ns)
        return PlannerSight(
            holding=flying and controller.counters.holding,
            inactive=not parts.is_active(),
            odometry_stale=not lockstep and controller.odometry_stale(stamp_ns),
            slots_fault=parts.slots.fault(leg) if parts.slots is not None else "",
            deadlock=flying and bool(controller.counters.deadlock),
            near_stale=flying and controller.near_stale,
            silent_estimates=" ".join(f"uav{i}" for i in silent),
            clock_offset=str(parts.timing.clock_offset.offset or ""),
            intruder=parts.endpoints.warning(),
            missed_ticks=missed,
            waiting_for=", ".join(missing),
            flying=flying,
        )
