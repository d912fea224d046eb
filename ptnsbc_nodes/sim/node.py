"""The simulated vehicles on ROS 2: state and near objects out, wrenches in.

In lock-step a vehicle steps from tick k when its wrench of tick k is in, and is told tick k+1 when it is its
turn (`turns`). In real time a node-clock timer steps all with the newest wrench of each UAV; without a
fresh one a vehicle hovers.
"""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ptnsbc_core.types import Array
from ptnsbc_io.wire import Stamped, decode_header, decode_wrench
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.diagnostics import STATUS_HZ, DiagnosticLevel, diagnostics, readiness
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.comm.topics import LOST, READY, RECORDED, RECORDER
from ptnsbc_nodes.runtime.pacing import Latency, Pace, Progress
from ptnsbc_nodes.runtime.watchdog import LockstepWatchdog
from ptnsbc_nodes.sim.lockstep import LockstepWorld
from ptnsbc_nodes.sim.publishers import SimPublishers
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.world import World

_MAX_CATCH_UP_S = 0.5
_LEAD_TICKS = 400  # well below the depth of the queues to the recorder


class SimNode:
    """The world as one rclpy node; calls `on_end` when the flight is over."""

    def __init__(
        self, node: Node, scenario: Scenario, edges: CommunicationGraph, on_end: Callable[[], None]
    ) -> None:
        self.node = node
        self._on_end = on_end
        self.endpoints = Endpoints(node, edges.options.lockstep)
        self._lockstep = edges.options.lockstep
        self._period_ns = scenario.dt_ns
        self._ticks = scenario.ticks
        self._stale_ns = round(scenario.file.communication.stale_s * 1e9)
        self._catch_up = max(round(_MAX_CATCH_UP_S * scenario.control_hz), 1)
        self._world = World(scenario)
        self._senses = SimPublishers(self.endpoints, scenario, self._world, edges.options)
        self._epochs = Epochs()
        self._pace = Pace(self._period_ns)
        self._latency = Latency()
        self._progress = Progress(scenario.control_hz)
        self._alive = set(self._world.ids)
        self._wrenches: dict[int, Stamped] = {}
        self._round = LockstepWorld(scenario, self._world, self._senses)
        self._running = False
        self._to_record = edges.options.recorded
        self._recorded = edges.options.lockstep and edges.options.recorded
        self._recorded_ns = 0
        self._paused = False
        self._listen()
        self._status = self.endpoints.publisher(topics.DIAGNOSTICS, edges.options.recorders)
        self._early_status = self.endpoints.publisher(READY, 0)
        self._standstill = LockstepWatchdog(self._early_status)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(1.0 / STATUS_HZ, self._on_status_timer, clock=steady)
        if not self._lockstep:
            node.create_timer(self._period_ns * 1e-9, self._on_tick_timer)

    def _listen(self) -> None:
        for i in self._world.ids:
            self.endpoints.listen(topics.wrench_setpoint(i), self._hearer(i))
        self.endpoints.listen(topics.EPOCH, self._on_epoch)
        self.endpoints.listen(LOST, self._on_lost, required=False)
        if self._recorded:
            self.endpoints.listen(RECORDED, self._on_recorded)

    def waiting_for(self) -> list[str]:
        """Topics without their other end."""
        missing = self.endpoints.unheard()
        before = self._to_record and not self._epochs.announced
        return missing + self.endpoints.unread() if self._lockstep or before else missing

    def _hearer(self, uav_id: int) -> Callable[[bytes], None]:
        def on_wrench(data: bytes) -> None:
            wrench = decode_wrench(data)
            if not self._lockstep:
                self._wrenches[uav_id] = wrench
                self._latency.add((self._clock_ns() - wrench.stamp_ns) * 1e-9)
            elif self._round.answer(uav_id, wrench):
                self._go_on()

        return on_wrench

    def _on_epoch(self, data: bytes) -> None:
        self._epochs.announce(*decode_header(data))
        if not self._lockstep:
            self.endpoints.begin(self._clock_ns())
        self._start()

    def _on_recorded(self, data: bytes) -> None:
        self._recorded_ns = decode_header(data).stamp_ns
        self._resume()

    def _ahead(self) -> bool:
        """Whether the recorder is so far behind that its queues could overflow."""
        return self._recorded and (
            self._world.t_ns - self._recorded_ns > _LEAD_TICKS * self._period_ns
        )

    def _resume(self) -> None:
        if self._paused and not self._ahead():
            self._paused = False
            self._go_on()

    def _on_lost(self, data: bytes) -> None:
        name = decode_header(data).frame_id.removeprefix("uav")
        if name == RECORDER:
            self._recorded = False
            self._resume()
        if name.isdecimal() and int(name) in self._alive:
            self._alive.discard(int(name))
            self._round.lose(int(name))
            self._go_on()

    def _start(self) -> None:
        """Lock-step: tell tick 0 once the epoch is known and nobody can miss it."""
        due = self._lockstep and not self._running and self._epochs.announced
        if due and not self.waiting_for():
            self._running = True
            self._progress.begin()
            self._go_on()

    def _go_on(self) -> None:
        """Lock-step: whatever can be done now, until UAVs have to answer, the recorder to catch up, or the end."""
        while self._lockstep and self._running and not self._paused:
            self._round.tell_time(min(self._world.tick, self._ticks - 1))
            if self._world.tick >= self._ticks:
                self._finish()
            elif self._ahead():
                self._paused = True
            elif told := self._round.tell():
                if told.together:
                    self._report(told.tick * self._period_ns)
                    self._progress.show(told.tick)
            else:
                return

    def _on_tick_timer(self) -> None:
        now_ns = self._clock_ns()
        periods = self._pace.tick(now_ns)
        fresh = self._fresh(now_ns)
        for _ in range(min(periods, self._catch_up)):
            self._world.step(fresh)
        self._senses.publish(now_ns)
        leg = self._epochs.at(now_ns)
        if leg is not None:
            self._flown((now_ns - leg.first_t0_ns) // self._period_ns)

    def _fresh(self, now_ns: int) -> dict[int, Array]:
        """Real time: the wrenches that still count."""
        return {
            i: wrench.values
            for i, wrench in self._wrenches.items()
            if i in self._alive and now_ns - wrench.stamp_ns <= self._stale_ns
        }

    def _silent(self, now_ns: int) -> str:
        """Real time, in flight: whose vehicles hover because their UAVs say nothing."""
        silent = [f"uav{i}" for i in self._world.ids if i not in self._fresh(now_ns)]
        return f"hovering without setpoints: {' '.join(silent)}" if silent else ""

    def _flown(self, ticks: int) -> None:
        if not self._running:
            self._running = True
            self._pace.missed = 0  # what others cost us while they started
            self._latency = Latency()
            self._progress.begin()
        self._progress.show(ticks)
        if ticks >= self._ticks:
            self._finish()

    def _finish(self) -> None:
        self._running = False
        self._progress.end(self._world.tick if self._lockstep else self._ticks)
        self._on_end()

    def _clock_ns(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def _on_status_timer(self) -> None:
        if not self._lockstep:
            self._report(self._clock_ns())
        elif self._running:
            self._standstill.look((self._round.answers, self._recorded_ns), self._awaited)
        else:
            self._start()
            if not self._running:
                self._report(-1)

    def _awaited(self) -> list[str]:
        """Lock-step: the processes without which the flight does not go on."""
        return [RECORDER] if self._paused else [f"uav{i}" for i in self._round.slowest()]

    def _report(self, stamp_ns: int) -> None:
        missing = self.waiting_for() if stamp_ns < 0 or not self._lockstep else []
        latency = self._latency
        values = {
            **readiness(missing),
            "ticks": str(self._world.tick),
            "missed_ticks": str(self._pace.missed),
            "latency_p50_ms": f"{1e3 * latency.percentile_s(50):.3f}",
            "latency_p99_ms": f"{1e3 * latency.percentile_s(99):.3f}",
            "latency_max_ms": f"{1e3 * latency.max_s:.3f}",
        }
        silent = "" if self._lockstep or not self._running else self._silent(stamp_ns)
        message = f"waiting for {' '.join(missing)}" if missing else silent
        level = DiagnosticLevel.WARN if message else DiagnosticLevel.OK
        send = self._status if stamp_ns >= 0 else self._early_status
        send(diagnostics(max(stamp_ns, 0), "sim: world", level, message, values))
