"""The simulated vehicles on ROS 2: state and near objects out, wrenches in.

In lock-step a vehicle steps from tick k when its wrench of tick k is here, and publishes tick k+1 when
`LockstepScheduler` allows it. In real time a node-clock timer steps all vehicles with the newest wrench of each
UAV; a vehicle without a fresh wrench hovers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import partial

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ptnsbc_io.wire import HeaderFields, Stamped, WireError, checked_wrench, decode_header
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import LostProcess, decode_leg, decode_lost
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, StatusPublisher, readiness
from ptnsbc_nodes.comm.door import RealTimeStamps, in_order
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.comm.topics import LOST, RECORDED, RECORDER
from ptnsbc_nodes.runtime.pacing import Latency, Progress
from ptnsbc_nodes.runtime.watchdog import LockstepWatchdog
from ptnsbc_nodes.sim.stepping import (
    LockstepWorld,
    RealTimeWorld,
    RecorderBacklog,
    SimPublishers,
)
from ptnsbc_sim.counters import STATUS_HZ
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.world import World


class SimNode(ABC):
    """The world as one rclpy node, in one of two clocks; it calls `on_end` when the flight is over."""

    rest_s: Callable[[], float | None] | None = None
    """In real time, after a tick: the time [s] until the next one, which uses the wrenches that come meanwhile."""

    def __init__(
        self, node: Node, scenario: Scenario, edges: CommunicationGraph, on_end: Callable[[], None]
    ) -> None:
        self.node = node
        self.endpoints = Endpoints(node, edges.options.lockstep, edges.options.seal)
        self._options = edges.options
        self._scenario = scenario
        self._on_end = on_end
        self._world = World(scenario)
        self._publishers = SimPublishers(self.endpoints, scenario, self._world, edges)
        self._epochs = Epochs(scenario)
        self._progress = Progress(scenario.timing.control_hz)
        self._running = False
        if scenario.formation.reconfigures:  # a successor of the leader announces the legs as well
            self.endpoints.shared.add(topics.EPOCH.name)
        self.endpoints.listen(topics.EPOCH, decode_leg, self._on_leg)
        self.endpoints.listen(LOST, decode_lost, self._on_lost, required=False)
        recorders = edges.options.recorders
        self._status = StatusPublisher(node, self.endpoints, "sim: world", recorders)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(1.0 / STATUS_HZ, self._on_status_timer, clock=steady)

    @abstractmethod
    def _on_leg(self, leg: HeaderFields) -> None:
        """The leader has announced a leg."""

    @abstractmethod
    def _on_lost(self, process: LostProcess) -> None:
        """A process has ended."""

    @abstractmethod
    def _on_status_timer(self) -> None:
        """`STATUS_HZ` times a second by wall time."""

    def waiting_for(self) -> list[str]:
        """Topics without their other end."""
        missing, early = self.endpoints.unheard(), not self._epochs.announced
        if early:
            missing += self.endpoints.contested()
        if self._options.lockstep or (self._options.recorded and early):
            missing += self.endpoints.unread()
        return missing

    def _begin(self) -> None:
        self._running = True
        self._progress.begin()

    def _finish(self, ticks: int) -> None:
        self._running = False
        self._progress.end(ticks)
        self._on_end()

    def _report(
        self,
        stamp_ns: int,
        missing: Sequence[str],
        *,
        missed: int = 0,
        latency: Latency | None = None,
        hovering: str = "",
    ) -> None:
        """Publish the status at an instant of the flight, -1 before it; `missing`: what the sim waits for."""
        latency = latency or Latency()
        values = {
            **readiness(missing),
            "ticks": str(self._world.tick),
            "missed_ticks": str(missed),
            "latency_p50_ms": f"{1e3 * latency.percentile_s(50):.3f}",
            "latency_p99_ms": f"{1e3 * latency.percentile_s(99):.3f}",
            "latency_max_ms": f"{1e3 * latency.max_s:.3f}",
            **self.endpoints.refusals.values(),
        }
        message = f"waiting for {', '.join(missing)}" if missing else hovering
        message = message or self.endpoints.warning()
        level = DiagnosticLevel.WARN if message else DiagnosticLevel.OK
        self._status.publish(stamp_ns, level, message, values)


class RealTimeSim(SimNode):
    """The world by the node's clock."""

    def __init__(
        self, node: Node, scenario: Scenario, edges: CommunicationGraph, on_end: Callable[[], None]
    ) -> None:
        super().__init__(node, scenario, edges, on_end)
        self.vehicles = RealTimeWorld(scenario, self._world, self._publishers)
        for i in self._world.ids:
            decode = in_order(checked_wrench, RealTimeStamps(self.now_ns))
            self.endpoints.listen(topics.wrench_setpoint(i), decode, partial(self._on_wrench, i))
        self._ticked = False
        self._timer = node.create_timer(scenario.timing.dt_ns * 1e-9, self._on_tick)
        self.rest_s = self._until_tick_s
        self.endpoints.last_word = self._on_status_timer

    def now_ns(self) -> int:
        """The time of the node's clock."""
        return int(self.node.get_clock().now().nanoseconds)

    def _on_wrench(self, uav_id: int, wrench: Stamped) -> None:
        self.vehicles.on_wrench(uav_id, wrench, self.now_ns())

    def _on_leg(self, leg: HeaderFields) -> None:
        self._epochs.announce(leg.stamp_ns, leg.frame_id)
        ahead = ((self._epochs.first_t0_ns or 0) - self.now_ns()) // self._scenario.timing.dt_ns
        self._world.begin_mission(self._world.tick + ahead)

    def _on_lost(self, process: LostProcess) -> None:
        if process.uav in self._world.ids:
            self.vehicles.lose(process.uav)

    def _on_tick(self) -> None:
        now_ns = self.now_ns()
        leg = self._epochs.at(now_ns)
        self._world.mission_s = -1.0 if leg is None else (now_ns - leg.first_t0_ns) * 1e-9
        self.vehicles.tick(now_ns)
        self._ticked = True
        if leg is None:
            return
        if not self._running:
            self.vehicles.begin()
            self._begin()
        ticks = (now_ns - leg.first_t0_ns) // self._scenario.timing.dt_ns
        self._progress.show(ticks)
        if ticks >= self._scenario.timing.ticks:
            self._finish(self._scenario.timing.ticks)

    def _until_tick_s(self) -> float | None:
        ticked, self._ticked = self._ticked, False
        return self._timer.time_until_next_call() * 1e-9 if ticked else None

    def _on_status_timer(self) -> None:
        now_ns, vehicles = self.now_ns(), self.vehicles
        self._report(
            now_ns,
            self.waiting_for(),
            missed=vehicles.pace.missed,
            latency=vehicles.latency,
            hovering=vehicles.hovering(now_ns) if self._running else "",
        )


class LockstepSim(SimNode):
    """The world by its own time, which waits for all UAVs and for the recorder."""

    def __init__(
        self, node: Node, scenario: Scenario, edges: CommunicationGraph, on_end: Callable[[], None]
    ) -> None:
        super().__init__(node, scenario, edges, on_end)
        self._vehicles = LockstepWorld(scenario, self._world, self._publishers)
        self._recorder = RecorderBacklog(scenario, edges.options.recorded)
        self._watchdog = LockstepWatchdog(self._status.send_ready)
        listen = self.endpoints.listen
        for i in self._world.ids:  # one stamp only is the right one
            listen(topics.wrench_setpoint(i), checked_wrench, partial(self._on_wrench, i))
        if edges.options.recorded:
            listen(RECORDED, self._decode_recorded, self._on_recorded)

    def _on_wrench(self, uav_id: int, wrench: Stamped) -> None:
        if self._vehicles.on_wrench(uav_id, wrench):
            self._advance()

    def _on_leg(self, leg: HeaderFields) -> None:
        self._epochs.announce(leg.stamp_ns, leg.frame_id)
        self._start()

    def _decode_recorded(self, data: bytes) -> int:
        stamp_ns = decode_header(data).stamp_ns
        first_ns, last_ns = self._recorder.recorded_ns, self._world.t_ns
        if not first_ns <= stamp_ns <= last_ns:
            raise WireError(f"recorded up to {stamp_ns} ns: expected {first_ns} to {last_ns}")
        return stamp_ns

    def _on_recorded(self, stamp_ns: int) -> None:
        self._recorder.recorded_ns = stamp_ns
        self._resume()

    def _resume(self) -> None:
        if self._recorder.paused and not self._recorder.behind(self._world.t_ns):
            self._recorder.paused = False
            self._advance()

    def _on_lost(self, process: LostProcess) -> None:
        if process.name == RECORDER:
            self._recorder.limits = False
            self._resume()
        if process.uav in self._world.ids:
            self._vehicles.lose(process.uav)
            self._advance()

    def _start(self) -> None:
        """Publish tick 0 once the epoch is known and every process receives it."""
        if not self._running and self._epochs.announced and not self.waiting_for():
            self._begin()
            self._advance()

    def _advance(self) -> None:
        """Go on until wrenches are missing, the recorder is behind, or the flight is over."""
        ticks, vehicles = self._scenario.timing.ticks, self._vehicles
        while self._running and not self._recorder.paused:
            vehicles.publish_clock(min(self._world.tick, ticks - 1))
            if self._world.tick >= ticks:
                self._finish(self._world.tick)
            elif self._recorder.behind(self._world.t_ns):
                self._recorder.paused = True
            elif published := vehicles.publish_due():
                if published.together:
                    self._report(published.tick * self._scenario.timing.dt_ns, [])
                    self._progress.show(published.tick)
            else:
                return

    def _on_status_timer(self) -> None:
        if self._running:
            progress = (self._vehicles.wrenches, self._recorder.recorded_ns)
            self._watchdog.look(progress, self._awaited)
            return
        self._start()
        if not self._running:
            self._report(-1, self.waiting_for())

    def _awaited(self) -> list[str]:
        """The processes without which the flight does not go on."""
        if self._recorder.paused:
            return [RECORDER]
        return [f"uav{i}" for i in self._vehicles.slowest()]


def sim_node(
    node: Node, scenario: Scenario, edges: CommunicationGraph, on_end: Callable[[], None]
) -> SimNode:
    """The sim in the clock of a flight."""
    kind = LockstepSim if edges.options.lockstep else RealTimeSim
    return kind(node, scenario, edges, on_end)
