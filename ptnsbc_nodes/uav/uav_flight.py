"""The flight of one UAV: its controller, the legs, its slot and its faults."""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.agent import PackedOutputs
from ptnsbc_core.types import MODE_HOLD
from ptnsbc_io.wire import HeaderFields, Stamped
from ptnsbc_nodes.comm.announcements import LostProcess
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.legs import Epochs, Leg
from ptnsbc_nodes.comm.vehicle_messages import PlannerLimits, limited
from ptnsbc_nodes.uav.open_slots import OpenSlots, SlotDecider, SlotHolder
from ptnsbc_nodes.uav.uav_controller import StepTime, Tick, UavController, role_holder, step_time
from ptnsbc_nodes.uav.uav_faults import UavFaults
from ptnsbc_sim.plugins.uav_plugins import UavPlugins
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.slots import are_open


class FlownStep(NamedTuple):
    """One control step."""

    at: StepTime
    own: Stamped  # the odometry that it flew by
    outputs: PackedOutputs


class UavFlight:
    """One UAV in flight, from the messages that it takes to the step that it makes."""

    def __init__(self, scenario: Scenario, uav_id: int, edges: CommunicationGraph) -> None:
        self.uav = uav_id
        self.scenario = scenario
        self.epochs = Epochs(scenario)
        self.controller = UavController(
            agent_config(scenario, uav_id),
            edges.senders(uav_id),
            UavPlugins.of(scenario, uav_id),
            role_holder(scenario, uav_id, edges),
        )
        self.inbox = self.controller.inbox
        self.faults = UavFaults(scenario, uav_id, self.inbox, edges.options.lockstep)
        self._holder = SlotHolder(scenario, uav_id, edges)
        self.slots: OpenSlots | None = None
        if are_open(scenario):
            self.slots = OpenSlots(scenario, self._holder, self.controller)
        self.decider: SlotDecider | None = None  # of the leader, where slots are open
        # A bridge brings its vehicle to the start before the first leg.
        self._at_start = not edges.options.bridged

    def leg(self, now_ns: int) -> Leg | None:
        """The leg in force for this UAV."""
        return self.epochs.at(now_ns, self.uav)

    def take_odometry(self, message: Stamped) -> None:
        """The own odometry."""
        self.inbox.own = message
        if self.decider is not None:
            self.decider.on_odometry(self.uav, message)

    def take_near(self, message: Stamped) -> None:
        """The near objects."""
        self.inbox.near = message

    def take_leg(self, leg: HeaderFields) -> bool:
        """A leg, or a word on a leg of the mission; returns whether it is new."""
        is_new = self.epochs.announce(leg.stamp_ns, leg.frame_id)
        if self.epochs.first_t0_ns is not None:
            self.faults.begin(self.epochs.first_t0_ns)
        return is_new

    def take_lost(self, process: LostProcess) -> None:
        """A process that has ended: nobody waits for its UAV."""
        if process.uav is not None:
            self.inbox.lose(process.uav)

    def take_limits(self, limits: PlannerLimits) -> None:
        """The limits of the vehicle, before its formation begins."""
        self.controller.config = limited(self.controller.config, *limits)

    def take_slot(self, leg: Leg | None) -> bool:
        """Take the slot of a leg; False while it is open and not decided."""
        return self.slots is None or self.slots.take(leg)

    def step(self, tick: Tick, start_ns: int) -> FlownStep:
        """Make the step of a tick; before the first leg its time counts from `start_ns`."""
        self.faults.strike(tick.now_ns)
        mission = self.epochs.scenario
        if mission is not None and mission is not self.scenario:
            self.scenario = mission
            self._holder.follow(self.controller, mission)
            if self.decider is not None:
                self.decider.follow(mission)
        leg = self.leg(tick.now_ns)
        if leg is not None and not self._at_start:
            self._at_start = True
            self.controller.restart()
        at = step_time(tick.now_ns, tick.elapsed_ns, leg, start_ns)
        if not self.take_slot(leg):
            at = at._replace(mode=MODE_HOLD)
        outputs = self.controller.step(at, tick.cutoff_ns)
        assert self.inbox.own is not None  # or no tick is due
        return FlownStep(at, self.inbox.own, outputs)
