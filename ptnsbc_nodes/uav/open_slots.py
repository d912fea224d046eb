"""The slots of a fleet: one UAV decides them by the odometry of all, and each takes its own. No ROS in here."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.types import MODE_FORMATION, Array
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import DecidedSlots, Decision
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.legs import Leg
from ptnsbc_nodes.uav.uav_controller import UavController
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.slots import Slots, optimal_slots, with_slots


class SlotHolder:
    """One UAV and the slot that it takes.

    Args:
        scenario: of the flight.
        uav_id: the UAV.
        edges: the communication graph of the scenario.
    """

    def __init__(self, scenario: Scenario, uav_id: int, edges: CommunicationGraph) -> None:
        self._scenario = scenario
        self._uav = uav_id
        self._edges = edges

    def take(self, controller: UavController, t0_ns: int, slots: Slots) -> None:
        """Have the controller fly by the slot that the epoch at `t0_ns` decided, unless it does."""
        if controller.slots is not None and controller.slots.stamp_ns == t0_ns:
            return
        config = agent_config(with_slots(self._scenario, slots), self._uav)
        senders = self._edges.holding(slots).senders(self._uav)
        controller.take_slot(stamped_slots(t0_ns, slots), config, senders)

    def follow(self, controller: UavController, scenario: Scenario) -> None:
        """Have the controller fly by the mission as it goes on after a word, in the slot that it has."""
        self._scenario = scenario
        if controller.slots is not None:
            held = controller.slots.values.tolist()
            slots = {
                uav: int(slot) for uav, slot in zip(sorted(scenario.uav_ids), held, strict=True)
            }
            scenario = with_slots(scenario, slots)
        scenario = controller.as_member(scenario)
        controller.go_on(agent_config(scenario, self._uav))


def stamped_slots(t0_ns: int, slots: Slots) -> Stamped:
    """Slots (N,) by ascending UAV, as a message that a step uses."""
    return Stamped(t0_ns, np.array([slots[uav] for uav in sorted(slots)], dtype=np.float64))


class OpenSlots:
    """The decisions that one UAV has heard, and its slot.

    Args:
        scenario: of the flight.
        holder: takes the slot.
        controller: of the UAV.
    """

    def __init__(self, scenario: Scenario, holder: SlotHolder, controller: UavController) -> None:
        self.decided = DecidedSlots(scenario)
        self._holder = holder
        self._controller = controller

    def take(self, leg: Leg | None) -> bool:
        """Take the slot of a leg; False while the slots of a formation leg are not known."""
        if leg is None or leg.mode != MODE_FORMATION:
            return True
        slots = self.decided.of(leg.t0_ns)
        if slots is None:
            return False
        self._holder.take(self._controller, leg.t0_ns, slots)
        return True

    def fault(self, leg: Leg | None) -> str:
        """The fault of the slots of a leg, empty without one."""
        missing = leg is not None and leg.mode == MODE_FORMATION
        if leg is None or not missing or self.decided.of(leg.t0_ns) is not None:
            return ""
        return f"holding: no slots of the epoch at {leg.t0_ns * 1e-9:.3f} s on {topics.SLOTS.name}"


class SlotDecider:
    """Decides the slots of an epoch from the newest odometry of all UAVs.

    Args:
        scenario: of the flight.
        announce: sends a decision.
    """

    def __init__(self, scenario: Scenario, announce: Callable[[Decision], None]) -> None:
        import scipy.optimize  # noqa: F401 - now, and not when a flight waits for the decision

        self._scenario = scenario
        self._announce = announce
        self._newest: dict[int, Stamped] = {}
        self._epoch_ns: int | None = None  # waits for odometry
        self._first_ns: int | None = None  # the first epoch, from which places that move count

    def follow(self, scenario: Scenario) -> None:
        """Decide by the mission as it goes on after a word."""
        self._scenario = scenario

    def on_odometry(self, uav_id: int, own: Stamped) -> None:
        """Take the newest odometry of a UAV."""
        self._newest[uav_id] = own
        if self._epoch_ns is not None:
            self.decide(self._epoch_ns)

    def unknown(self, since_ns: int) -> list[int]:
        """UAVs whose odometry is missing or older than `since_ns`."""
        found = {uav: self._newest.get(uav) for uav in self._scenario.uav_ids}
        return [uav for uav, own in found.items() if own is None or own.stamp_ns < since_ns]

    def decide(self, t0_ns: int) -> None:
        """Decide the slots of the epoch at `t0_ns`: at once, or when all odometry is here."""
        self._epoch_ns = t0_ns
        if self._first_ns is None:
            self._first_ns = t0_ns
        if len(self._newest) == len(self._scenario.uav_ids):
            self._epoch_ns = None
            positions = {uav: at_epoch(own, t0_ns) for uav, own in self._newest.items()}
            since_s = (t0_ns - self._first_ns) * 1e-9
            self._announce(Decision(t0_ns, optimal_slots(self._scenario, positions, since_s)))


def at_epoch(own: Stamped, t0_ns: int) -> Array:
    """Position (3,) [m], ENU, to which a UAV will have moved by the epoch, at the velocity that it measures."""
    ahead_s = max(t0_ns - own.stamp_ns, 0) * 1e-9
    found: Array = own.values[0:3] + ahead_s * np.array(velocity_enu(own.values))
    return found
