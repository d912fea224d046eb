"""The simulated vehicles on ROS 2: state and near objects out, wrenches in.

In lock-step a vehicle steps from tick k when its wrench of tick k is here, and publishes tick k+1 when
`LockstepScheduler` allows it. In real time a node-clock timer steps all vehicles with the newest wrench of each
UAV; a vehicle without a fresh wrench hovers.
"""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer

from ptnsbc_io.wire import HeaderFields, Stamped, WireError, checked_wrench, decode_header
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import LostProcess, decode_leg, decode_lost
from ptnsbc_nodes.comm.diagnostics import (
    STATUS_HZ,
    DiagnosticLevel,
    StatusLog,
    diagnostics,
    readiness,
    status_every,
)
from ptnsbc_nodes.comm.door import RealTimeStamps, in_order
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.comm.topics import LOST, READY, RECORDED, RECORDED_EVERY, RECORDER
from ptnsbc_nodes.runtime.pacing import Progress
from ptnsbc_nodes.runtime.watchdog import LockstepWatchdog
from ptnsbc_nodes.sim.lockstep import LockstepWorld
from ptnsbc_nodes.sim.publishers import SimPublishers
from ptnsbc_nodes.sim.real_time import RealTimeWorld
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.world import World


class SimNode:
    """The world as one rclpy node; it calls `on_end` when the flight is over."""

    def __init__(
        self, node: Node, scenario: Scenario, edges: CommunicationGraph, on_end: Callable[[], None]
    ) -> None:
        self.node = node
        self.endpoints = Endpoints(node, edges.options.lockstep, edges.options.seal)
        self._options = edges.options
        self._scenario = scenario
        self._on_end = on_end
        self._world = World(scenario)
        publishers = SimPublishers(self.endpoints, scenario, self._world, edges)
        self._lockstep = LockstepWorld(scenario, self._world, publishers)
        self._real_time = RealTimeWorld(scenario, self._world, publishers)
        self._epochs = Epochs(scenario)
        self._progress = Progress(scenario.timing.control_hz)
        self._running = False
        lead_ns = _lead_ticks(scenario) * scenario.timing.dt_ns
        self._recorder = _RecorderBacklog(
            edges.options.lockstep and edges.options.recorded, lead_ns
        )
        self._subscribe()
        self._send_status = self.endpoints.publisher(topics.DIAGNOSTICS, edges.options.recorders)
        self._send_ready = self.endpoints.publisher(READY, 0)
        self._log = StatusLog(node)
        self._watchdog = LockstepWatchdog(self._send_ready)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(1.0 / STATUS_HZ, self._on_status_timer, clock=steady)
        self._ticked = False
        self.rest_s: Callable[[], float | None] | None = None
        """In real time, after a tick: the time [s] until the next one, which uses the wrenches that come meanwhile."""
        if not edges.options.lockstep:
            ticks = node.create_timer(scenario.timing.dt_ns * 1e-9, self._on_tick_timer)
            self.rest_s = lambda: self._until_tick_s(ticks)
            self.endpoints.last_word = lambda: self._report(self._clock_ns())

    def _until_tick_s(self, ticks: Timer) -> float | None:
        if not self._ticked:
            return None
        self._ticked = False
        return ticks.time_until_next_call() * 1e-9

    def _subscribe(self) -> None:
        listen = self.endpoints.listen
        for i in self._world.ids:
            decode: Callable[[bytes], Stamped] = checked_wrench
            if not self._options.lockstep:  # in lock-step one stamp only is the right one
                decode = in_order(decode, RealTimeStamps(self._clock_ns))
            listen(topics.wrench_setpoint(i), decode, self._on_wrench(i))
        if (
            self._scenario.formation.reconfigures
        ):  # a successor of the leader announces the legs as well
            self.endpoints.shared.add(topics.EPOCH.name)
        listen(topics.EPOCH, decode_leg, self._on_epoch)
        listen(LOST, decode_lost, self._on_lost, required=False)
        if self._recorder.limits:
            listen(RECORDED, self._decode_recorded, self._on_recorded)

    def waiting_for(self) -> list[str]:
        """Topics without their other end."""
        missing, early = self.endpoints.unheard(), not self._epochs.announced
        if early:
            missing += self.endpoints.contested()
        if self._options.lockstep or (self._options.recorded and early):
            missing += self.endpoints.unread()
        return missing

    def _on_wrench(self, uav_id: int) -> Callable[[Stamped], None]:
        def on_wrench(wrench: Stamped) -> None:
            if not self._options.lockstep:
                self._real_time.on_wrench(uav_id, wrench, self._clock_ns())
            elif self._lockstep.on_wrench(uav_id, wrench):
                self._advance()

        return on_wrench

    def _on_epoch(self, leg: HeaderFields) -> None:
        self._epochs.announce(leg.stamp_ns, leg.frame_id)
        if not self._options.lockstep:
            first_ns = self._epochs.first_t0_ns or 0
            ahead = (first_ns - self._clock_ns()) // self._scenario.timing.dt_ns
            self._world.begin_mission(self._world.tick + ahead)
        self._start()

    def _decode_recorded(self, data: bytes) -> int:
        stamp_ns = decode_header(data).stamp_ns
        if not self._recorder.recorded_ns <= stamp_ns <= self._world.t_ns:
            raise WireError(
                f"recorded up to {stamp_ns} ns: expected {self._recorder.recorded_ns} to {self._world.t_ns}"
            )
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
            self._real_time.lose(process.uav)
            self._lockstep.lose(process.uav)
            self._advance()

    def _start(self) -> None:
        """Lock-step: publish tick 0 once the epoch is known and every process receives it."""
        due = self._options.lockstep and not self._running and self._epochs.announced
        if due and not self.waiting_for():
            self._running = True
            self._progress.begin()
            self._advance()

    def _advance(self) -> None:
        """Lock-step: go on until wrenches are missing, the recorder is behind, or the flight is over."""
        ticks, lockstep = self._scenario.timing.ticks, self._lockstep
        while self._options.lockstep and self._running and not self._recorder.paused:
            lockstep.publish_clock(min(self._world.tick, ticks - 1))
            if self._world.tick >= ticks:
                self._finish()
            elif self._recorder.behind(self._world.t_ns):
                self._recorder.paused = True
            elif published := lockstep.publish_due():
                if published.together:
                    self._report(published.tick * self._scenario.timing.dt_ns)
                    self._progress.show(published.tick)
            else:
                return

    def _on_tick_timer(self) -> None:
        now_ns = self._clock_ns()
        leg = self._epochs.at(now_ns)
        self._world.mission_s = -1.0 if leg is None else (now_ns - leg.first_t0_ns) * 1e-9
        self._real_time.tick(now_ns)
        self._ticked = True
        if leg is None:
            return
        if not self._running:
            self._running = True
            self._real_time.begin()
            self._progress.begin()
        ticks = (now_ns - leg.first_t0_ns) // self._scenario.timing.dt_ns
        self._progress.show(ticks)
        if ticks >= self._scenario.timing.ticks:
            self._finish()

    def _finish(self) -> None:
        self._running = False
        self._progress.end(
            self._world.tick if self._options.lockstep else self._scenario.timing.ticks
        )
        self._on_end()

    def _clock_ns(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def _on_status_timer(self) -> None:
        if not self._options.lockstep:
            self._report(self._clock_ns())
        elif self._running:
            progress = (self._lockstep.wrenches, self._recorder.recorded_ns)
            self._watchdog.look(progress, self._awaited)
        else:
            self._start()
            if not self._running:
                self._report(-1)

    def _awaited(self) -> list[str]:
        """Lock-step: the processes without which the flight does not go on."""
        if self._recorder.paused:
            return [RECORDER]
        return [f"uav{i}" for i in self._lockstep.slowest()]

    def _report(self, stamp_ns: int) -> None:
        """Publish the status at an instant of the flight; -1 is before the flight."""
        lockstep, latency = self._options.lockstep, self._real_time.latency
        missing = self.waiting_for() if stamp_ns < 0 or not lockstep else []
        values = {
            **readiness(missing),
            "ticks": str(self._world.tick),
            "missed_ticks": str(self._real_time.pace.missed),
            "latency_p50_ms": f"{1e3 * latency.percentile_s(50):.3f}",
            "latency_p99_ms": f"{1e3 * latency.percentile_s(99):.3f}",
            "latency_max_ms": f"{1e3 * latency.max_s:.3f}",
        }
        hovering = "" if lockstep or not self._running else self._real_time.hovering(stamp_ns)
        values |= self.endpoints.refusals.values()
        message = f"waiting for {', '.join(missing)}" if missing else hovering
        message = message or self.endpoints.warning()
        level = DiagnosticLevel.WARN if message else DiagnosticLevel.OK
        self._log.note(level, message)
        send = self._send_status if stamp_ns >= 0 else self._send_ready
        send(diagnostics(max(stamp_ns, 0), "sim: world", level, message, values))


def _lead_ticks(scenario: Scenario) -> int:
    """Lock-step: ticks that the sim may be ahead of what the recorder has received.

    What waits takes the recorder's memory and a place in its queues. A topic is complete up to its next message, and
    the recorder is up to one word late: half of the lead. The other half lets the sim go on meanwhile.
    """
    return 2 * (status_every(scenario) + RECORDED_EVERY)


class _RecorderBacklog:
    """Lock-step: how far the recorder is; the sim pauses before the recorder's queues can overflow."""

    def __init__(self, limits: bool, lead_ns: int) -> None:
        self.limits = limits  # whether there is a recorder to wait for
        self._lead_ns = lead_ns
        self.recorded_ns = 0
        self.paused = False

    def behind(self, now_ns: int) -> bool:
        return self.limits and now_ns - self.recorded_ns > self._lead_ns
