"""The subscriptions and publishers of one UAV, and the setpoints of a user's program for its leader."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from rclpy.node import Node

from ptnsbc_core.nanoseconds import nanoseconds
from ptnsbc_io.wire import OdometryDecoder, OdometryTemplate, Stamped, checked_near
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME, AgentMessages, body_frame
from ptnsbc_nodes.comm.announcements import Decision, decode_lost, encode_slots
from ptnsbc_nodes.comm.door import RealTimeStamps, RefusedMessage, in_lockstep, in_order
from ptnsbc_nodes.comm.endpoints import Endpoints, full_name
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.comm.vehicle_messages import decode_limits
from ptnsbc_nodes.uav.clocks import UavClock
from ptnsbc_nodes.uav.inbox import MessageQueue
from ptnsbc_nodes.uav.step_log import SnapshotTemplate, TickTemplate, used_by
from ptnsbc_nodes.uav.uav_controller import FlownStep, SlotDecider, UavFlight
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.constants import PlannerLimits


class Subscriptions:
    """Everything that a UAV hears, on its way into its flight."""

    def __init__(
        self,
        node: Node,
        endpoints: Endpoints,
        edges: CommunicationGraph,
        flight: UavFlight,
        clock: UavClock,
    ) -> None:
        self._node, self._endpoints, self._flight, self._clock = node, endpoints, flight, clock
        # An odometry may come from a program that has other names for its frames; neighbours are UAVs of ours.
        self.odom_name = self._hear_odometry(flight.uav, flight.take_odometry)
        near = in_order(checked_near, clock.stamp_rule())
        endpoints.listen(topics.near(flight.uav), near, flight.take_near, required=clock.lockstep)
        self._hear_neighbours()
        endpoints.listen(topics.LOST, decode_lost, flight.take_lost, required=False)
        if flight.decided is not None:
            endpoints.listen(topics.SLOTS, flight.decided.decode, flight.decided.keep)
            if flight.uav == flight.scenario.leader.id:
                self._decide_slots(edges)
        if edges.options.bridged:
            endpoints.listen(topics.limits(flight.uav), decode_limits, self._take_limits)

    def _take_limits(self, limits: PlannerLimits) -> None:
        controller = self._flight.controller
        controller.config = limits.lowering(controller.config)

    def _decide_slots(self, edges: CommunicationGraph) -> None:
        """Decide the slots of the fleet, by the odometry of all UAVs."""
        flight, scenario = self._flight, self._flight.scenario
        publish = self._endpoints.publisher(topics.SLOTS, edges.readers(topics.SLOTS))

        def announce(decision: Decision) -> None:
            publish(encode_slots(decision))
            if flight.decided is not None:
                flight.decided.keep(decision)

        decider = flight.decider = SlotDecider(scenario, announce)
        for uav in scenario.uav_ids:
            if uav != flight.uav:
                self._hear_odometry(uav, partial(decider.on_odometry, uav))

    def unknown_positions(self) -> list[str]:
        """Real time: odometry that the decision on the slots lacks."""
        if self._flight.decider is None or self._clock.lockstep:
            return []
        stale_ns = nanoseconds(self._flight.controller.config.stale_s)
        unknown = self._flight.decider.unknown(self._clock.now_ns() - stale_ns)
        return [full_name(self._node, topics.odom(uav)) for uav in unknown]

    def _hear_odometry(self, uav: int, take: Callable[[Stamped], None]) -> str:
        decode = in_order(OdometryDecoder(), self._clock.stamp_rule())
        return self._endpoints.listen(topics.odom(uav), decode, take)

    def _hear_neighbours(self) -> None:
        inbox, fleet = self._flight.inbox, self._endpoints.fleet
        states, estimates = inbox.state_queues.items(), inbox.estimate_queues.items()
        heard = [(topics.formation_state(i), body_frame(i, fleet), queue) for i, queue in states]
        heard += [(topics.leader_estimate(i), WORLD_FRAME, queue) for i, queue in estimates]
        for topic, frame, queue in heard:
            decode, rule = OdometryDecoder(WORLD_FRAME, frame), self._clock.stamp_rule()
            if isinstance(rule, RealTimeStamps):
                self._endpoints.listen(topic, in_order(decode, rule), queue.put)
            else:
                take = partial(self._take_in_lockstep, full_name(self._node, topic), queue)
                self._endpoints.listen(topic, in_lockstep(decode, rule), take)

    def _take_in_lockstep(
        self, name: str, queue: MessageQueue, message: Stamped | RefusedMessage
    ) -> None:
        if isinstance(message, Stamped):
            queue.put(message)
        else:  # a lock-step flight does not wait for what cannot be used
            self._endpoints.refusals.add(name, message.reason)
            queue.miss(message.stamp_ns)


class Outbox:
    """Publishers of one UAV: what it sends at each tick, and in real time the log to repeat its steps by.

    Velocities and the log are for bridges and recorders: without a subscriber they are not encoded.
    """

    def __init__(self, endpoints: Endpoints, edges: CommunicationGraph, flight: UavFlight) -> None:
        uav, recorders = flight.uav, edges.options.recorders
        self._messages = AgentMessages(uav, endpoints.fleet, flight.faults.sending)
        self._send_wrench, self._send_state, self._send_estimate, self._send_velocity = (
            endpoints.publisher(topic, edges.readers(topic))
            for topic in (
                topics.wrench_setpoint(uav),
                topics.formation_state(uav),
                topics.leader_estimate(uav),
                topics.velocity_setpoint(uav),
            )
        )
        self._velocity_readers = endpoints.readers(topics.velocity_setpoint(uav))
        self._logs = not edges.options.lockstep
        if self._logs:
            self._controller = flight.controller
            self._snapshot_every = flight.scenario.timing.control_hz  # steps
            self._senders = flight.inbox.senders
            self._tick = TickTemplate(self._senders)
            self._snapshot: SnapshotTemplate | None = None
            self._send_tick = endpoints.publisher(topics.tick(uav), recorders)
            self._send_snapshot = endpoints.publisher(topics.snapshot(uav), recorders)
            self._tick_readers = endpoints.readers(topics.tick(uav))
            self._snapshot_readers = endpoints.readers(topics.snapshot(uav))

    def send(self, step: FlownStep) -> None:
        """Publish a step; the wrench first, because the plant waits for it."""
        messages, outputs, stamp_ns = self._messages, step.outputs, step.own.stamp_ns
        self._send_wrench(messages.wrench(stamp_ns, outputs.wrench))
        self._send_state(messages.state(step.own, outputs))
        self._send_estimate(messages.estimate(stamp_ns, outputs.leader_estimate))
        if self._velocity_readers():
            self._send_velocity(messages.velocity(stamp_ns, outputs.velocity))
        if not self._logs:
            return
        controller = self._controller
        sequence = controller.steps - 1
        if self._tick_readers():
            if controller.inbox.senders is not self._senders:  # it has taken another slot
                self._senders = controller.inbox.senders
                self._tick = TickTemplate(self._senders)
            self._send_tick(self._tick.encode(sequence, step.at, used_by(controller)))
        if sequence % self._snapshot_every == 0 and self._snapshot_readers():
            self._snapshot = self._snapshot or SnapshotTemplate(controller)
            self._send_snapshot(self._snapshot.encode(sequence, controller))


def follow_setpoints(endpoints: Endpoints, readers: int, epochs: Epochs, clock: UavClock) -> None:
    """Hear setpoints, and have the leader follow those that it can follow.

    A setpoint counts from the tick after its arrival. In which tick that is decides the program that sends it; the
    leader tells it on /formation/setpoint_taken, which has so many `readers`: by it the bag is judged and run again.
    """
    template = OdometryTemplate(WORLD_FRAME, WORLD_FRAME)
    tell = endpoints.publisher(topics.TAKEN, readers)
    decode = in_order(OdometryDecoder(WORLD_FRAME, WORLD_FRAME), RealTimeStamps(clock.next_ns))

    def plan(data: bytes) -> tuple[Stamped, Scenario]:
        setpoint = Stamped(clock.next_ns(), decode(data).values)
        return setpoint, epochs.following(*setpoint)

    def take(planned: tuple[Stamped, Scenario]) -> None:
        setpoint, epochs.scenario = planned
        tell(template.encode(*setpoint))

    endpoints.listen(topics.SETPOINT, plan, take, required=False)
