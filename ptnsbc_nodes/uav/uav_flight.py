"""The flight of one UAV: its controller, the legs, its slot and its faults. No ROS in here.

Of a fleet with open slots one UAV decides them by the odometry of all, and each takes its own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ptnsbc_core.agent import PackedOutputs
from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import MODE_FORMATION, MODE_HOLD, Array
from ptnsbc_io.wire import HeaderFields, Stamped
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import DecidedSlots, Decision, LostProcess
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.legs import Epochs, Leg
from ptnsbc_nodes.uav.uav_controller import StepTime, Tick, UavController, step_time
from ptnsbc_nodes.uav.uav_faults import UavFaults
from ptnsbc_sim.plugins.uav_plugins import UavPlugins
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.slots import optimal_slots


class SlotDecider:
    """Decides the slots of an epoch from the newest odometry of all UAVs."""

    def __init__(self, scenario: Scenario, announce: Callable[[Decision], None]) -> None:
        """`announce`: sends a decision."""
        import scipy.optimize  # noqa: F401 - now, and not when a flight waits for the decision

        self.scenario = scenario  # the mission as it goes on after a word
        self._announce = announce
        self._newest: dict[int, Stamped] = {}
        self._epoch_ns: int | None = None  # waits for odometry
        self._first_ns: int | None = None  # the first epoch, from which places that move count

    def on_odometry(self, uav_id: int, own: Stamped) -> None:
        """Take the newest odometry of a UAV."""
        self._newest[uav_id] = own
        if self._epoch_ns is not None:
            self.decide(self._epoch_ns)

    def unknown(self, since_ns: int) -> list[int]:
        """UAVs whose odometry is missing or older than `since_ns`."""
        found = {uav: self._newest.get(uav) for uav in self.scenario.uav_ids}
        return [uav for uav, own in found.items() if own is None or own.stamp_ns < since_ns]

    def decide(self, t0_ns: int) -> None:
        """Decide the slots of the epoch at `t0_ns`: at once, or when all odometry is here."""
        self._epoch_ns = t0_ns
        if self._first_ns is None:
            self._first_ns = t0_ns
        if len(self._newest) == len(self.scenario.uav_ids):
            self._epoch_ns = None
            positions = {uav: at_epoch(own, t0_ns) for uav, own in self._newest.items()}
            since_s = (t0_ns - self._first_ns) * 1e-9
            self._announce(Decision(t0_ns, optimal_slots(self.scenario, positions, since_s)))


def at_epoch(own: Stamped, t0_ns: int) -> Array:
    """Position (3,) [m], ENU, to which a UAV will have moved by the epoch, at the velocity that it measures."""
    ahead_s = max(t0_ns - own.stamp_ns, 0) * 1e-9
    found: Array = own.values[0:3] + ahead_s * np.array(velocity_enu(own.values))
    return found


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
        plugins = UavPlugins.of(scenario, uav_id)
        self.controller = UavController(scenario, uav_id, edges, plugins)
        self.inbox = self.controller.inbox
        self.faults = UavFaults(scenario, uav_id, self.inbox, edges.options.lockstep)
        self.decided = DecidedSlots(scenario) if scenario.formation.has_open_slots else None
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

    def take_slot(self, leg: Leg | None) -> bool:
        """Take the slot of a leg; False while it is open and not decided."""
        if self.decided is None or leg is None or leg.mode != MODE_FORMATION:
            return True
        slots = self.decided.of(leg.t0_ns)
        if slots is not None:
            self.controller.take_slot(leg.t0_ns, slots)
        return slots is not None

    def slots_fault(self, leg: Leg | None) -> str:
        """The fault of the slots of a leg, empty without one."""
        if self.decided is None or leg is None or leg.mode != MODE_FORMATION:
            return ""
        if self.decided.of(leg.t0_ns) is not None:
            return ""
        return f"holding: no slots of the epoch at {leg.t0_ns * 1e-9:.3f} s on {topics.SLOTS.name}"

    def step(self, tick: Tick, start_ns: int) -> FlownStep:
        """Make the step of a tick; before the first leg its time counts from `start_ns`."""
        self.faults.strike(tick.now_ns)
        mission = self.epochs.scenario
        if mission is not self.scenario:
            self.scenario = mission
            self.controller.follow(mission)
            if self.decider is not None:
                self.decider.scenario = mission
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
