"""One UAV on ROS 2: bytes in, one control step per tick, bytes out.

In real time a node-clock timer ticks at the control rate with the newest messages. In lock-step a tick
happens when all its messages are here: the own odometry of tick k, and the neighbours' messages of k-1.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from rclpy.node import Node

from ptnsbc_core.types import MODE_HOLD
from ptnsbc_io.wire import HeaderFields, OdometryDecoder, Stamped, checked_near
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import (
    LostProcess,
    OrderedFault,
    decode_leg,
    decode_lost,
    fault_decoder,
)
from ptnsbc_nodes.comm.diagnostics import (
    INACTIVE,
)
from ptnsbc_nodes.comm.door import (
    in_order,
)
from ptnsbc_nodes.comm.endpoints import Endpoints, full_name
from ptnsbc_nodes.comm.graph import CommunicationGraph, Senders
from ptnsbc_nodes.comm.legs import Epochs, Leg
from ptnsbc_nodes.comm.robot_description import publish_description
from ptnsbc_nodes.comm.slots import Decision, encode_slots
from ptnsbc_nodes.comm.topics import LOST
from ptnsbc_nodes.comm.vehicle_messages import PlannerLimits, decode_limits, limited
from ptnsbc_nodes.runtime.pacing import ClockOffsetMonitor
from ptnsbc_nodes.uav.controller import UavController, step_time
from ptnsbc_nodes.uav.faults import UavFaults
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_nodes.uav.leader_setpoints import LeaderSetpoints
from ptnsbc_nodes.uav.leg_services import LegServices
from ptnsbc_nodes.uav.neighbours import NeighbourListener
from ptnsbc_nodes.uav.outbox import Outbox
from ptnsbc_nodes.uav.roles import role_holder
from ptnsbc_nodes.uav.slots import OpenSlots, SlotDecider, SlotHolder
from ptnsbc_nodes.uav.status import StatusPublisher, UavParts, VehiclePresence
from ptnsbc_nodes.uav.timing import UavTiming
from ptnsbc_sim.plugins.uav_plugins import UavPlugins
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.slots import are_open

_FAULT_WINDOW_NS = 5_000_000_000


class UavNode:
    """The controller of one UAV: one rclpy node, one tick; it only listens until `activate`."""

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
        self._vehicle = VehiclePresence(on_abandoned)
        self.endpoints = Endpoints(node, edges.options.lockstep, edges.options.seal)
        self._options = edges.options
        self._uav = uav_id
        self._scenario = scenario
        plugins = UavPlugins.of(scenario, uav_id)
        roles = role_holder(scenario, uav_id, edges)
        self._controller = UavController(
            agent_config(scenario, uav_id), edges.senders(uav_id), plugins, roles
        )
        self._faults = UavFaults(scenario, uav_id, self._controller.inbox, edges.options.lockstep)
        self._outbox = Outbox(self.endpoints, edges, uav_id, self._faults)
        publish_description(self.endpoints, scenario, uav_id)
        self._epochs = Epochs(scenario)
        names = self._controller.inbox.topic_names(uav_id)
        self._timing = UavTiming(node, scenario, names, edges.options.lockstep)
        self._active = False
        self._at_start = not edges.options.bridged
        """True if the UAV is at its start; a bridge brings its vehicle there before the first leg."""
        self._slots = self._decider = None
        if are_open(scenario):
            self._slots = OpenSlots(scenario, uav_id, edges, self._controller)
        self._holder = (
            SlotHolder(scenario, uav_id, edges) if self._slots is None else self._slots.holder
        )
        self._subscribe(scenario, uav_id)
        if self._slots is not None and uav_id == scenario.leader.id:
            self._decider = self._slot_decider(scenario, edges)
        self._status = StatusPublisher(node, self._parts())
        self._comes_and_goes = roles is not None
        self._leg_services = self._services_in_line(scenario, edges)
        if scenario.takes_setpoints and uav_id == scenario.leader.id:
            LeaderSetpoints(
                self.endpoints, edges.options.recorders, self._epochs, self._next_flight_ns
            )
        if not self._options.lockstep:
            self._outbox.log_steps(self.endpoints, edges, uav_id, every=scenario.timing.control_hz)

    @property
    def begun(self) -> bool:
        """True if a leg has been announced."""
        return self._epochs.announced

    def activate(self) -> None:
        """Begin to tick. In real time control begins anew, where the vehicle is by then."""
        self._active = True
        if not self._options.lockstep:
            self._controller.restart()
            self._timing.start(self._on_tick_timer)
        self._advance()

    def deactivate(self) -> None:
        """Publish nothing but diagnostics; go on listening."""
        self._active = False
        self._timing.stop()

    def close(self) -> None:
        """Remove everything from the node."""
        self.deactivate()
        self._status.close()
        if self._leg_services is not None:
            self._leg_services.close()
        self.endpoints.close()

    def _parts(self) -> UavParts:
        return UavParts(
            self._uav,
            self._options,
            self.endpoints,
            self._epochs,
            self._timing,
            self._controller,
            self._faults,
            self._slots,
            lambda: self._active,
            self.waiting_for,
            self.look_for_vehicle,
        )

    def waiting_for(self) -> list[str]:
        """Topics without their other end; in real time also an odometry that has not arrived yet.

        Before the first leg a recorded topic waits for its recorder. In flight a recorder or a child that
        ends is no reason to wait.
        """
        missing = self.endpoints.unheard()
        if not self._active:
            missing.append(INACTIVE)
        if not self._epochs.announced:
            missing += self.endpoints.contested()
        if self._options.lockstep:
            return missing + self.endpoints.unread()
        if self._options.recorded and not self._epochs.announced:
            missing += self.endpoints.unread()
            if self._leg_services is not None:
                missing += self._leg_services.missing_listeners()
        if self._controller.inbox.own is None and self._odom_name not in missing:
            missing.append(self._odom_name)
        if not self._epochs.announced:
            missing += [name for name in self._unknown_positions() if name not in missing]
        offset = self._timing.clock_offset.offset
        if offset is not None and not self._epochs.announced:
            missing.append(f"another time: {offset}")
        return missing

    def _waiting_to_start(self) -> list[str]:
        """The things for which a leg in formation waits: with open slots, positions too."""
        missing = self.waiting_for()
        return [*missing, *(name for name in self._unknown_positions() if name not in missing)]

    def _unknown_positions(self) -> list[str]:
        """Real time: odometry that the decision on the slots lacks."""
        if self._decider is None or self._options.lockstep:
            return []
        stale_ns = round(self._controller.config.stale_s * 1e9)
        unknown = self._decider.unknown(self._timing.now_ns() - stale_ns)
        return [full_name(self.node, topics.odom(uav)) for uav in unknown]

    def _services_in_line(
        self, scenario: Scenario, edges: CommunicationGraph
    ) -> LegServices | None:
        """The services of the leader, which a successor serves when it leads; None for all others."""
        if self._comes_and_goes:
            self.endpoints.shared.add(topics.EPOCH.name)
        leads = self._uav == scenario.leader.id
        if not leads and not (self._comes_and_goes and self._uav in scenario.leader.successors):
            return None
        services = LegServices(
            self.node,
            self.endpoints,
            edges,
            self._epochs,
            self._flight_ns,
            self._waiting_to_start,
            self._decider,
            edges.epoch_readers() if leads else 0,
        )
        if leads:
            services.serve()
        return services

    def _serve_while_leading(self) -> None:
        """Serve the operator while the UAV leads, where UAVs may come and go."""
        if self._leg_services is None or not self._comes_and_goes:
            return
        if self._controller.leads:
            self._leg_services.serve()
        else:
            self._leg_services.close()

    def _slot_decider(self, scenario: Scenario, edges: CommunicationGraph) -> SlotDecider:
        """The decision on the slots, by the odometry of all UAVs."""
        publish = self.endpoints.publisher(topics.SLOTS, edges.slots_readers())

        def announce(decision: Decision) -> None:
            publish(encode_slots(decision))
            self._on_slots(decision)

        decider = SlotDecider(scenario, announce)
        for uav in scenario.uav_ids:
            if uav != scenario.leader.id:
                decode = in_order(OdometryDecoder(), self._timing.stamp_rule())
                self.endpoints.listen(topics.odom(uav), decode, partial(decider.on_odometry, uav))
        return decider

    def look_for_vehicle(self, now_s: float) -> None:
        """Notice when the process of the vehicle is gone for good."""
        self._vehicle.look(self._odom_name not in self.endpoints.unheard(), now_s)

    def _subscribe(self, scenario: Scenario, uav_id: int) -> None:
        listen, inbox = self.endpoints.listen, self._controller.inbox
        # An odometry may come from a program that has other names for its frames; neighbours are UAVs of ours.
        odom = in_order(OdometryDecoder(), self._timing.stamp_rule())
        near = in_order(checked_near, self._timing.stamp_rule())
        self._odom_name = listen(topics.odom(uav_id), odom, self._on_odom)
        listen(topics.near(uav_id), near, self._on_near, required=self._options.lockstep)
        NeighbourListener(self.node, self.endpoints, self._timing, self._advance).listen(inbox)
        listen(topics.EPOCH, decode_leg, self._on_epoch)
        if self._faults.allowed:
            listen(topics.FAULT, fault_decoder(scenario.uav_ids), self._on_fault, required=False)
        if self._slots is not None:
            listen(topics.SLOTS, self._slots.decided.decode, self._on_slots)
        listen(LOST, decode_lost, self._on_lost, required=False)
        if self._options.bridged:
            listen(topics.limits(uav_id), decode_limits, self._on_limits)

    def _flight_ns(self) -> int:
        return max(self._timing.done_ns, 0) if self._options.lockstep else self._timing.now_ns()

    def _next_flight_ns(self) -> int:
        """Time of the flight that no tick has reached yet."""
        return self._flight_ns() + (self._timing.period_ns if self._options.lockstep else 0)

    def _on_odom(self, message: Stamped) -> None:
        self._controller.inbox.own = message
        if self._decider is not None:
            self._decider.on_odometry(self._uav, message)
        self._advance()

    def _on_near(self, message: Stamped) -> None:
        self._controller.inbox.near = message
        self._advance()

    def _on_epoch(self, leg: HeaderFields) -> None:
        is_new = self._epochs.announce(leg.stamp_ns, leg.frame_id)
        if is_new and self._leg_services is not None and not self._options.lockstep:
            self._leg_services.keep(leg)  # in lock-step no process starts in flight
        first_ns = self._epochs.first_t0_ns
        if first_ns is not None:
            self._faults.begin(first_ns)
        self._timing.align(self._controller.inbox.own)
        self._advance()

    def _on_fault(self, order: OrderedFault) -> None:
        """A fault that an operator injects; in real time all UAVs count it from the same instant."""
        now_ns = self._flight_ns()
        alike = not self._options.lockstep and abs(order.stamp_ns - now_ns) < _FAULT_WINDOW_NS
        self._faults.inject(order.fault, order.stamp_ns if alike else now_ns)

    def _follow_mission(self) -> None:
        """Fly by what was said of the legs of the mission."""
        scenario = self._epochs.scenario
        if scenario is None or scenario is self._scenario:
            return
        self._scenario = scenario
        self._holder.follow(self._controller, scenario)
        if self._decider is not None:
            self._decider.follow(scenario)

    def _on_slots(self, decision: Decision) -> None:
        """Take the decision on the slots; a UAV that hears it after its epoch holds until then."""
        if self._slots is not None:
            self._slots.decided.keep(decision)
        self._advance()

    def _take_slot(self, leg: Leg | None) -> bool:
        """Take the slot of a leg; False while it is open and not decided."""
        if self._slots is None:
            return True
        before = self._controller.inbox.senders
        known = self._slots.take(leg)
        self._watch_clocks_unless(before)
        return known

    def _watch_clocks_unless(self, before: Senders) -> None:
        """Compare the clocks of other senders than before, if there are others."""
        inbox = self._controller.inbox
        if inbox.senders is not before:
            self._timing.clock_offset = ClockOffsetMonitor(inbox.topic_names(self._uav))

    def _on_lost(self, process: LostProcess) -> None:
        if process.uav is not None:
            self._controller.inbox.lose(process.uav)
        self._advance()

    def _on_limits(self, limits: PlannerLimits) -> None:
        """The limits of the vehicle, before its formation begins."""
        self._controller.config = limited(self._controller.config, *limits)

    def _advance(self) -> None:
        """Lock-step: do the tick if everything for it is here."""
        inbox, timing = self._controller.inbox, self._timing
        own = inbox.own
        if not self._options.lockstep or own is None or not self._active:
            return
        now_ns = own.stamp_ns
        if now_ns <= timing.done_ns or not self._epochs.announced:
            return
        if self._faults.plays_dead(now_ns):
            self._controller.forget()
            timing.done(now_ns)
            return
        if not self._take_slot(self._epochs.at(now_ns, self._uav)):
            return  # the decision is on its way
        if inbox.holds_tick(timing.period_ns, timing.near_every):
            self._tick(own, now_ns, now_ns, timing.period_ns)
            if now_ns // timing.period_ns % timing.status_every == 0:
                self._status.publish(now_ns)

    def _on_tick_timer(self) -> None:
        inbox, timing = self._controller.inbox, self._timing
        now_ns = timing.now_ns()
        periods = timing.pace.tick(now_ns)
        timing.clock_offset.look(now_ns, inbox.held(NO_CUTOFF_NS, NO_CUTOFF_NS))
        # A setpoint proves that the controller has fresh odometry, so there is none without it.
        if inbox.own is not None and not self._controller.odometry_stale(now_ns):
            self._tick(inbox.own, now_ns, NO_CUTOFF_NS, periods * timing.period_ns)

    def _tick(self, own: Stamped, now_ns: int, cutoff_ns: int, elapsed_ns: int) -> None:
        self._faults.strike(now_ns)
        self._follow_mission()
        leg, timing = self._epochs.at(now_ns, self._uav), self._timing
        if leg is None:  # not announced or still to come
            timing.pace.missed = 0
        elif not self._at_start:
            self._at_start = True
            self._controller.restart()
        at = step_time(now_ns, elapsed_ns, leg, timing.start_ns)
        if not self._take_slot(leg):
            at = at._replace(mode=MODE_HOLD)
        before = self._controller.inbox.senders
        outputs = self._controller.step(at, cutoff_ns)
        self._watch_clocks_unless(before)
        timing.done(now_ns)
        self._outbox.send(own, outputs, at, self._controller)
        if leg is not None:
            self._serve_while_leading()
