"""The simulated vehicles on ROS 2: state and near objects out, wrenches in.

In real time a node-clock timer steps all vehicles with the newest wrench of each UAV; a vehicle without a fresh wrench
hovers. In lock-step a vehicle publishes its state, receives a wrench for it, and steps. A barrier at every tick would
leave the machine idle while the last UAV computes. A barrier is needed only where the world looks at all vehicles at
once (near objects, status, markers): a *meeting*. Between meetings a vehicle moves on as soon as its own wrench is
here, so that no UAV waits for one that does not concern it. The UAVs themselves wait for their neighbours' messages.
The result is the same, bit for bit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import Array
from ptnsbc_io.wire import (
    HeaderFields,
    OdometryTemplate,
    Stamped,
    WireError,
    checked_wrench,
    decode_header,
    encode_clock,
    encode_near,
)
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME, LiveTransforms, body_frame
from ptnsbc_nodes.comm.announcements import LostProcess, decode_leg, decode_lost
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, StatusPublisher, readiness
from ptnsbc_nodes.comm.door import RealTimeStamps, in_order
from ptnsbc_nodes.comm.drawing import Scene
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import LEAD_TICKS, CommunicationGraph
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.comm.topics import RECORDED, RECORDED_EVERY, RECORDER
from ptnsbc_nodes.runtime.pacing import Latency, Pace, Progress, clock_of
from ptnsbc_nodes.runtime.watchdog import LockstepWatchdog
from ptnsbc_sim.counters import STATUS_HZ, status_every
from ptnsbc_sim.disturbances.faults import gone
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.world import World

_MAX_CATCH_UP_S = 0.5
_LATE_PERIODS = 2.5  # a wrench in time is one period old, and two where its UAV has missed one tick


class SimPublishers:
    """Publishers of the sim: all at once in real time, one vehicle at a time in lock-step."""

    def __init__(
        self, endpoints: Endpoints, scenario: Scenario, world: World, edges: CommunicationGraph
    ) -> None:
        self._world = world
        self._near_every = scenario.near_every
        self._scene_every = status_every(scenario)
        self._calls = 0
        self._scene = Scene(scenario)
        ids, recorders = world.ids, edges.options.recorders
        self._templates = {
            i: OdometryTemplate(WORLD_FRAME, body_frame(i, endpoints.fleet)) for i in ids
        }
        self._send_odom, self._send_near = (
            {i: endpoints.publisher(topic(i), edges.readers(topic(i))) for i in ids}
            for topic in (topics.odom, topics.near)
        )
        measured = ids if scenario.imperfect else ()
        self._send_truth = {i: endpoints.publisher(topics.truth(i), recorders) for i in measured}
        self._send_clock = endpoints.publisher(topics.CLOCK, recorders)
        self._send_markers = endpoints.publisher(topics.MARKERS, recorders)
        self._tf = LiveTransforms(endpoints, ids)

    def publish(self, stamp_ns: int) -> None:
        """Publish the world's state; near objects and markers at their own rates."""
        for i in self._world.ids:
            self.vehicle(i, self._calls, stamp_ns)
        self.clock(stamp_ns)
        if self._calls % self._scene_every == 0:
            self.markers(stamp_ns)
        self._calls += 1

    def vehicle(self, uav_id: int, tick: int, stamp_ns: int) -> None:
        """Publish the odometry of one UAV, and at the rate of its sensor the near objects."""
        template = self._templates[uav_id]
        odometry = template.encode(stamp_ns, self._world.odometry(uav_id))
        self._send_odom[uav_id](odometry)
        self._tf.publish(uav_id, odometry)
        if uav_id in self._send_truth:
            self._send_truth[uav_id](template.encode(stamp_ns, self._world.truth(uav_id)))
        if tick % self._near_every == 0:
            near = self._world.near(uav_id)
            self._send_near[uav_id](encode_near(stamp_ns, WORLD_FRAME, near))

    def clock(self, stamp_ns: int) -> None:
        """Publish the time."""
        self._send_clock(encode_clock(stamp_ns))

    def markers(self, stamp_ns: int) -> None:
        """Publish markers for viewers."""
        world = self._world
        places = np.array([world.odometry(i)[0:3] for i in world.ids])
        self._send_markers(self._scene.markers(stamp_ns, places, world.obstacle_positions()))


class RealTimeWorld:
    """The vehicles of `world` in real time; one keeps its attitude while its wrench is late, and hovers without one.

    Torques are right for a control period. Held for a tenth of a second while a computer is busy, they turn a
    vehicle over; the flight controllers of real ones do not let that happen.
    """

    def __init__(self, scenario: Scenario, world: World, publish: Callable[[int], None]) -> None:
        """`publish`: publishes the states at a stamp [ns]."""
        self._world = world
        self._publish = publish
        self._dt_ns = scenario.timing.dt_ns
        self._stale_ns = nanoseconds(scenario.communication.stale_s)
        self._late_ns = round(_LATE_PERIODS * self._dt_ns)
        self._catch_up = max(round(_MAX_CATCH_UP_S * scenario.timing.control_hz), 1)
        self.wrenches: dict[int, Stamped] = {}  # the newest (6,) of each UAV
        self.pace = Pace(self._dt_ns)
        self.latency = Latency()

    def tick(self, now_ns: int) -> None:
        """Step all vehicles to now, and publish their states."""
        periods = min(self.pace.tick(now_ns), self._catch_up)
        fresh, late = self._fresh(now_ns), self._world.with_late_setpoint
        for at_ns in range(now_ns - (periods - 1) * self._dt_ns, now_ns + 1, self._dt_ns):
            acting = {
                i: late(i, wrench.values)
                if at_ns - wrench.stamp_ns > self._late_ns
                else wrench.values
                for i, wrench in fresh.items()
            }
            self._world.step(acting)
        self._publish(now_ns)

    def hovering(self, now_ns: int) -> str:
        """The vehicles that hover because their UAVs send no setpoints; empty when none does."""
        fresh = self._fresh(now_ns)
        names = [f"uav{i}" for i in self._world.ids if i not in fresh]
        return f"hovering without setpoints: {' '.join(names)}" if names else ""

    def _fresh(self, now_ns: int) -> dict[int, Stamped]:
        return {
            i: wrench
            for i, wrench in self.wrenches.items()
            if now_ns - wrench.stamp_ns <= self._stale_ns
        }


class LockstepScheduler:
    """Order of the steps: it tells which vehicles may publish their next state.

    Args:
        ticks: of the state of each vehicle; the world counts them.
        end: the tick at which the flight is over; its state is not published.
        meetings: periods [ticks] at whose multiples all vehicles meet.
    """

    def __init__(self, ticks: Mapping[int, int], end: int, meetings: Sequence[int]) -> None:
        self._ticks = ticks
        self._unpublished = list(ticks)
        self._end = end
        self._meetings = tuple(meetings)

    def awaited(self, uav_id: int) -> bool:
        """True if the state of this UAV is published and its wrench is not here yet."""
        return uav_id not in self._unpublished

    def mark_published(self, uav_id: int) -> None:
        """The state of this UAV is published."""
        self._unpublished.remove(uav_id)

    def mark_moved(self, uav_id: int) -> None:
        """The vehicle has moved on by one tick: it has a state that nobody knows."""
        self._unpublished.append(uav_id)

    def due(self) -> list[int]:
        """UAVs whose state may be published now, in the order in which they became ready."""
        slowest = min(self._ticks.values())
        return [i for i in self._unpublished if self._may_go(self._ticks[i], slowest)]

    def _may_go(self, tick: int, slowest: int) -> bool:
        if any(tick % period == 0 for period in self._meetings):
            return tick == slowest  # no vehicle passes a meeting before the last one arrives
        return tick < self._end and tick <= slowest + LEAD_TICKS


def recorder_lead_ns(scenario: Scenario) -> int:
    """Lock-step: how far the sim may be ahead of the recorder [ns], before the recorder's queues can overflow.

    What waits takes the recorder's memory and a place in its queues. A topic is complete up to its next message, and
    the recorder is up to one word late: half of the lead. The other half lets the sim go on meanwhile.
    """
    return 2 * (status_every(scenario) + RECORDED_EVERY) * scenario.timing.dt_ns


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
        self._progress = Progress(scenario.timing.control_hz, scenario.timing.duration_s)
        self._running = False
        if scenario.formation.reconfigures:  # a successor of the leader announces the legs as well
            self.endpoints.shared.add(topics.EPOCH.name)
        self.endpoints.listen(topics.EPOCH, decode_leg, self._on_leg)
        self.endpoints.listen(topics.LOST, decode_lost, self._on_lost, required=False)
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
        self.vehicles = RealTimeWorld(scenario, self._world, self._publishers.publish)
        self.now_ns = clock_of(node)
        for i in self._world.ids:
            decode = in_order(checked_wrench, RealTimeStamps(self.now_ns))
            self.endpoints.listen(topics.wrench_setpoint(i), decode, partial(self._on_wrench, i))
        self._ticked = False
        self._timer = node.create_timer(seconds(scenario.timing.dt_ns), self._on_tick)
        self.rest_s = self._until_tick_s
        self.endpoints.last_word = self._on_status_timer

    def _on_wrench(self, uav_id: int, wrench: Stamped) -> None:
        self.vehicles.wrenches[uav_id] = wrench
        self.vehicles.latency.add(seconds(self.now_ns() - wrench.stamp_ns))

    def _on_leg(self, leg: HeaderFields) -> None:
        self._epochs.announce(leg.stamp_ns, leg.frame_id)
        ahead = ((self._epochs.first_t0_ns or 0) - self.now_ns()) // self._scenario.timing.dt_ns
        self._world.begin_mission(self._world.tick + ahead)

    def _on_lost(self, process: LostProcess) -> None:
        if process.uav is not None:  # a process that takes its place flies its vehicle again
            self.vehicles.wrenches.pop(process.uav, None)

    def _on_tick(self) -> None:
        now_ns = self.now_ns()
        leg = self._epochs.at(now_ns)
        self._world.mission_s = -1.0 if leg is None else seconds(now_ns - leg.first_t0_ns)
        self.vehicles.tick(now_ns)
        self._ticked = True
        if leg is None:
            return
        if not self._running:  # delays by the start of other processes do not count
            self.vehicles.pace.missed, self.vehicles.latency = 0, Latency()
            self._begin()
        ticks = (now_ns - leg.first_t0_ns) // self._scenario.timing.dt_ns
        self._progress.show(ticks)
        if ticks >= self._scenario.timing.ticks:
            self._finish(self._scenario.timing.ticks)

    def _until_tick_s(self) -> float | None:
        ticked, self._ticked = self._ticked, False
        return seconds(self._timer.time_until_next_call()) if ticked else None

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
    """The world by its own time, which waits for all UAVs and for the recorder.

    A vehicle whose UAV is lost stays where it is, and one whose UAV restarts does so for that time.
    """

    def __init__(
        self, node: Node, scenario: Scenario, edges: CommunicationGraph, on_end: Callable[[], None]
    ) -> None:
        super().__init__(node, scenario, edges, on_end)
        self._dt_ns, self._status_every = scenario.timing.dt_ns, status_every(scenario)
        self._scheduler = LockstepScheduler(
            self._world.ticks, scenario.timing.ticks, (scenario.near_every, self._status_every)
        )
        self._lost: set[int] = set()
        silent = gone(scenario, ("restart",))
        self._silent = {uav: silent[:, row] for row, uav in enumerate(scenario.uav_ids)}
        self._next_clock_tick = self._wrenches = 0
        self._awaits_recorder, self._paused = edges.options.recorded, False
        self._lead_ns, self._recorded_ns = recorder_lead_ns(scenario), 0
        self._watchdog = LockstepWatchdog(self._status.send_ready)
        listen = self.endpoints.listen
        for i in self._world.ids:  # one stamp only is the right one
            listen(topics.wrench_setpoint(i), checked_wrench, partial(self._on_wrench, i))
        if edges.options.recorded:
            listen(RECORDED, self._decode_recorded, self._on_recorded)

    def _on_wrench(self, uav_id: int, wrench: Stamped) -> None:
        tick = self._world.ticks[uav_id]
        if self._scheduler.awaited(uav_id) and wrench.stamp_ns == tick * self._dt_ns:
            self._step(uav_id, wrench.values)
            self._wrenches += 1
            self._advance()

    def _on_leg(self, leg: HeaderFields) -> None:
        self._epochs.announce(leg.stamp_ns, leg.frame_id)
        self._start()

    def _decode_recorded(self, data: bytes) -> int:
        stamp_ns = decode_header(data).stamp_ns
        first_ns, last_ns = self._recorded_ns, self._world.t_ns
        if not first_ns <= stamp_ns <= last_ns:
            raise WireError(f"recorded up to {stamp_ns} ns: expected {first_ns} to {last_ns}")
        return stamp_ns

    def _on_recorded(self, stamp_ns: int) -> None:
        self._recorded_ns = stamp_ns
        self._resume()

    def _on_lost(self, process: LostProcess) -> None:
        if process.name == RECORDER:
            self._awaits_recorder = False
            self._resume()
        if process.uav in self._world.ids:
            self._lost.add(process.uav)
            if self._scheduler.awaited(process.uav):
                self._step(process.uav, None)
            self._advance()

    def _recorder_is_behind(self) -> bool:
        return self._awaits_recorder and self._world.t_ns - self._recorded_ns > self._lead_ns

    def _resume(self) -> None:
        if self._paused and not self._recorder_is_behind():
            self._paused = False
            self._advance()

    def _start(self) -> None:
        """Publish tick 0 once the epoch is known and every process receives it."""
        if not self._running and self._epochs.announced and not self.waiting_for():
            self._begin()
            self._advance()

    def _advance(self) -> None:
        """Go on until wrenches are missing, the recorder is behind, or the flight is over."""
        ticks = self._scenario.timing.ticks
        while self._running and not self._paused:
            for tick in range(self._next_clock_tick, min(self._world.tick, ticks - 1) + 1):
                self._publishers.clock(tick * self._dt_ns)
                self._next_clock_tick = tick + 1
            if self._world.tick >= ticks:
                self._finish(self._world.tick)
            elif self._recorder_is_behind():
                self._paused = True
            elif due := self._scheduler.due():
                self._publish(due)
            else:
                return

    def _publish(self, due: Sequence[int]) -> None:
        """Publish the states of these UAVs; at the tick of a status they are all, and markers and status follow."""
        ticks, tick = self._world.ticks, 0
        for i in due:
            tick = ticks[i]
            self._publishers.vehicle(i, tick, tick * self._dt_ns)
            self._scheduler.mark_published(i)
        together = tick % self._status_every == 0
        if together:
            self._publishers.markers(tick * self._dt_ns)
        for i in due:
            if i in self._lost or self._silent[i][ticks[i]]:
                self._step(i, None)
        if together:
            self._report(tick * self._dt_ns, [])
            self._progress.show(tick)

    def _step(self, uav_id: int, wrench: Array | None) -> None:
        self._world.step_one(uav_id, wrench)
        self._scheduler.mark_moved(uav_id)

    def _on_status_timer(self) -> None:
        if self._running:
            self._watchdog.look((self._wrenches, self._recorded_ns), self._awaited)
            return
        self._start()
        if not self._running:
            self._report(-1, self.waiting_for())

    def _awaited(self) -> list[str]:
        """The processes without which the flight does not go on: UAVs whose wrench of the earliest tick is missing."""
        if self._paused:
            return [RECORDER]
        awaited = [i for i in self._world.ids if self._scheduler.awaited(i)]
        ticks = self._world.ticks
        first = min((ticks[i] for i in awaited), default=0)
        return [f"uav{i}" for i in awaited if ticks[i] == first]


def sim_node(
    node: Node, scenario: Scenario, edges: CommunicationGraph, on_end: Callable[[], None]
) -> SimNode:
    """The sim in the clock of a flight."""
    kind = LockstepSim if edges.options.lockstep else RealTimeSim
    return kind(node, scenario, edges, on_end)
