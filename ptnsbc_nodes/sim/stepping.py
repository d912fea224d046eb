"""Steps and topics of the simulated vehicles: in real time all at once, in lock-step each when its wrench is here.

In lock-step a vehicle publishes its state, receives a wrench for it, and steps. A barrier at every tick would leave the
machine idle while the last UAV computes. A barrier is needed only where the world looks at all vehicles at once (near
objects, status, markers): a *meeting*. Between meetings a vehicle moves on as soon as its own wrench is here, so
that no UAV waits for one that does not concern it. The UAVs themselves wait for their neighbours' messages. The
result is the same, bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from ptnsbc_core.types import Array
from ptnsbc_io.wire import OdometryTemplate, Stamped, encode_clock, encode_near
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME, LiveTransforms, body_frame
from ptnsbc_nodes.comm.drawing import Scene
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import LEAD_TICKS, CommunicationGraph
from ptnsbc_nodes.comm.topics import RECORDED_EVERY
from ptnsbc_nodes.runtime.pacing import Latency, Pace
from ptnsbc_sim.counters import status_every
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
        self._scene = Scene(scenario, world)
        ids, recorders = world.ids, edges.options.recorders
        self._odometry_templates = {
            i: OdometryTemplate(WORLD_FRAME, body_frame(i, endpoints.fleet)) for i in ids
        }
        self._send_odom = {
            i: endpoints.publisher(topics.odom(i), edges.readers(topics.odom(i))) for i in ids
        }
        self._send_truth = (
            {i: endpoints.publisher(topics.truth(i), recorders) for i in ids}
            if scenario.imperfect
            else {}
        )
        self._send_near = {
            i: endpoints.publisher(topics.near(i), edges.readers(topics.near(i))) for i in ids
        }
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
        state = self._world.odometry(uav_id)
        odometry = self._odometry_templates[uav_id].encode(stamp_ns, state)
        self._send_odom[uav_id](odometry)
        self._tf.publish(uav_id, odometry)
        if uav_id in self._send_truth:
            truth = self._world.truth(uav_id)
            self._send_truth[uav_id](self._odometry_templates[uav_id].encode(stamp_ns, truth))
        if tick % self._near_every == 0:
            near = self._world.near(uav_id)
            self._send_near[uav_id](encode_near(stamp_ns, WORLD_FRAME, near))

    def clock(self, stamp_ns: int) -> None:
        """Publish the time."""
        self._send_clock(encode_clock(stamp_ns))

    def markers(self, stamp_ns: int) -> None:
        """Publish markers for viewers."""
        self._send_markers(self._scene.markers(stamp_ns))


class RealTimeWorld:
    """The vehicles of `world` in real time; one keeps its attitude while its wrench is late, and hovers without one.

    Torques are right for a control period. Held for a tenth of a second while a computer is busy, they turn a
    vehicle over; the flight controllers of real ones do not let that happen.
    """

    def __init__(self, scenario: Scenario, world: World, publishers: SimPublishers) -> None:
        self._world = world
        self._publishers = publishers
        self._stale_ns = round(scenario.communication.stale_s * 1e9)
        self._late_ns = round(_LATE_PERIODS * scenario.timing.dt_ns)
        self._dt_ns = scenario.timing.dt_ns
        self._catch_up = max(round(_MAX_CATCH_UP_S * scenario.timing.control_hz), 1)
        self._wrenches: dict[int, Stamped] = {}
        self.pace = Pace(scenario.timing.dt_ns)
        self.latency = Latency()

    def begin(self) -> None:
        """The flight begins: delays by the start of other processes do not count."""
        self.pace.missed = 0
        self.latency = Latency()

    def on_wrench(self, uav_id: int, wrench: Stamped, now_ns: int) -> None:
        """Take the wrench (6,) of one UAV."""
        self._wrenches[uav_id] = wrench
        self.latency.add((now_ns - wrench.stamp_ns) * 1e-9)

    def lose(self, uav_id: int) -> None:
        """Forget the wrench of this UAV, whose process has ended; a process that takes its place flies it again."""
        self._wrenches.pop(uav_id, None)

    def tick(self, now_ns: int) -> None:
        """Step all vehicles to now, and publish their states."""
        periods = min(self.pace.tick(now_ns), self._catch_up)
        fresh = self._fresh(now_ns)
        for left in range(periods - 1, -1, -1):
            self._world.step(self._acting(fresh, now_ns - left * self._dt_ns))
        self._publishers.publish(now_ns)

    def hovering(self, now_ns: int) -> str:
        """The vehicles that hover because their UAVs send no setpoints; empty when none does."""
        fresh = self._fresh(now_ns)
        names = [f"uav{i}" for i in self._world.ids if i not in fresh]
        return f"hovering without setpoints: {' '.join(names)}" if names else ""

    def _acting(self, fresh: Mapping[int, Stamped], at_ns: int) -> dict[int, Array]:
        """The wrenches (6,) of one control period."""
        late = self._world.with_late_setpoint
        return {
            i: late(i, one.values) if at_ns - one.stamp_ns > self._late_ns else one.values
            for i, one in fresh.items()
        }

    def _fresh(self, now_ns: int) -> dict[int, Stamped]:
        return {
            i: wrench
            for i, wrench in self._wrenches.items()
            if now_ns - wrench.stamp_ns <= self._stale_ns
        }


class LockstepScheduler:
    """The tick of each vehicle, and which vehicles may publish their next state.

    Args:
        uav_ids: all vehicles.
        end: the tick at which the flight is over; its state is not published.
        meetings: periods [ticks] at whose multiples all vehicles meet.
    """

    def __init__(self, uav_ids: Iterable[int], end: int, meetings: Sequence[int]) -> None:
        self._at = dict.fromkeys(uav_ids, 0)
        self._unpublished = list(self._at)
        self._slowest = 0
        self._end = end
        self._meetings = tuple(meetings)

    @property
    def slowest(self) -> int:
        """The tick that every vehicle has reached."""
        return self._slowest

    def at(self, uav_id: int) -> int:
        """The tick of one vehicle's state."""
        return self._at[uav_id]

    def awaited(self, uav_id: int) -> bool:
        """True if the state of this UAV is published and its wrench is not here yet."""
        return uav_id not in self._unpublished

    def mark_published(self, uav_id: int) -> None:
        """The state of this UAV is published."""
        self._unpublished.remove(uav_id)

    def step(self, uav_id: int) -> None:
        """The vehicle has moved on by one tick."""
        tick = self._at[uav_id]
        self._at[uav_id] = tick + 1
        self._unpublished.append(uav_id)
        if tick == self._slowest:
            self._slowest = min(self._at.values())

    def due(self) -> list[int]:
        """UAVs whose state may be published now, in the order in which they became ready."""
        return [i for i in self._unpublished if self._may_go(self._at[i])]

    def _may_go(self, tick: int) -> bool:
        if any(tick % period == 0 for period in self._meetings):
            return tick == self._slowest  # no vehicle passes a meeting before the last one arrives
        return tick < self._end and tick <= self._slowest + LEAD_TICKS


class RecorderBacklog:
    """Lock-step: how far the recorder is; the sim pauses before the recorder's queues can overflow.

    What waits takes the recorder's memory and a place in its queues. A topic is complete up to its next message, and
    the recorder is up to one word late: half of the lead. The other half lets the sim go on meanwhile.
    """

    def __init__(self, scenario: Scenario, limits: bool) -> None:
        self.limits = limits  # whether there is a recorder to wait for
        self.lead_ns = 2 * (status_every(scenario) + RECORDED_EVERY) * scenario.timing.dt_ns
        self.recorded_ns = 0
        self.paused = False

    def behind(self, now_ns: int) -> bool:
        """True if the recorder lacks more than it may."""
        return self.limits and now_ns - self.recorded_ns > self.lead_ns


class StatePublished(NamedTuple):
    """The states of some vehicles were published."""

    tick: int
    together: bool  # of all vehicles, at a tick at which the status is due


class LockstepWorld:
    """The vehicles of `world` in lock-step; a vehicle whose UAV is lost stays where it is."""

    def __init__(self, scenario: Scenario, world: World, publishers: SimPublishers) -> None:
        self._world = world
        self._publishers = publishers
        self._period_ns = scenario.timing.dt_ns
        self._status_every = status_every(scenario)
        self._scheduler = LockstepScheduler(
            world.ids, scenario.timing.ticks, (scenario.near_every, self._status_every)
        )
        self._lost: set[int] = set()
        silent = gone(scenario, ("restart",))
        self._silent = {uav: silent[:, row] for row, uav in enumerate(scenario.uav_ids)}
        self._next_clock_tick = 0
        self.wrenches = 0

    def on_wrench(self, uav_id: int, wrench: Stamped) -> bool:
        """Take the wrench (6,) of one UAV; returns whether its vehicle waits for it."""
        scheduler = self._scheduler
        if (
            not scheduler.awaited(uav_id)
            or wrench.stamp_ns != scheduler.at(uav_id) * self._period_ns
        ):
            return False
        self._step(uav_id, wrench.values)
        self.wrenches += 1
        return True

    def slowest(self) -> list[int]:
        """UAVs whose wrench is missing at the earliest tick."""
        scheduler = self._scheduler
        awaited = [i for i in self._world.ids if scheduler.awaited(i)]
        first = min((scheduler.at(i) for i in awaited), default=0)
        return [i for i in awaited if scheduler.at(i) == first]

    def lose(self, uav_id: int) -> None:
        """Stop waiting for this UAV, whose process has ended."""
        self._lost.add(uav_id)
        if self._scheduler.awaited(uav_id):
            self._step(uav_id, None)

    def publish_clock(self, tick: int) -> None:
        """Publish the time of every tick up to this one, each once."""
        for k in range(self._next_clock_tick, tick + 1):
            self._publishers.clock(k * self._period_ns)
            self._next_clock_tick = k + 1

    def publish_due(self) -> StatePublished | None:
        """Publish the states that may be published now; None if there are none."""
        due = self._scheduler.due()
        if not due:
            return None
        tick = 0
        for i in due:
            tick = self._scheduler.at(i)
            self._publishers.vehicle(i, tick, tick * self._period_ns)
            self._scheduler.mark_published(i)
        together = tick % self._status_every == 0
        if together:
            self._publishers.markers(tick * self._period_ns)
        for i in due:
            if i in self._lost or self._silent[i][self._scheduler.at(i)]:
                self._step(i, None)
        return StatePublished(tick, together)

    def _step(self, uav_id: int, wrench: Array | None) -> None:
        self._world.step_one(uav_id, wrench)
        self._scheduler.step(uav_id)
