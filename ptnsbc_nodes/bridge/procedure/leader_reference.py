"""The motion of the leader as one bridge follows it: the legs that are announced, its trajectory, and the own place."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.curves.shape import places
from ptnsbc_core.curves.trajectory import Reference, reference
from ptnsbc_core.types import AgentConfig, Array
from ptnsbc_nodes.bridge.ports import BridgeInputs
from ptnsbc_nodes.comm.legs import Epochs, Leg
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.build import leader_trajectory
from ptnsbc_sim.scenario.mission.membership import joins_ns, leaves_ns
from ptnsbc_sim.scenario.model import NANOSECONDS
from ptnsbc_sim.scenario.slots import are_open


class LeaderReference:
    """Legs and trajectory of a flight, brought up to date by what arrives."""

    def __init__(self, scenario: Scenario, uav_id: int) -> None:
        self._scenario, self._uav_id = scenario, uav_id
        self._epochs = Epochs(scenario)
        self.config = agent_config(scenario, uav_id)

    def update(self, inputs: BridgeInputs) -> None:
        """Take in the legs and the setpoints of the leader that have arrived."""
        while inputs.legs:
            if self._epochs.announce(*inputs.legs.pop(0)):
                self.config = agent_config(self._flown(), self._uav_id)
        while inputs.taken:
            self._epochs.take(inputs.taken.pop(0))
            self.config = self.config._replace(trajectory=leader_trajectory(self._flown()))

    def leg(self, now_ns: int) -> Leg | None:
        """The leg in force for the vehicle; None before the first."""
        return self._epochs.at(now_ns, self._uav_id)

    def leaves(self, now_ns: int) -> bool:
        """True if the vehicle lands while the others fly on."""
        own, others = self.leg(now_ns), self._epochs.at(now_ns)
        return own is not None and own != others

    def flight_s(self, now_ns: int) -> float:
        """Time since the first epoch; negative before it."""
        leg = self.leg(now_ns)
        return -1.0 if leg is None else (now_ns - leg.first_t0_ns) * 1e-9

    def at(self, flight_s: float) -> Reference:
        """The leader's motion so many seconds after the first epoch; before it, that of the epoch."""
        return reference(self.config.trajectory, max(flight_s, 0.0))

    def place_velocity(self, flight_s: float) -> Array:
        """Velocity (3,) [m/s] of the vehicle's place in the formation, which may move beside the leader."""
        known = not are_open(self._scenario)
        return place_velocity(self.config, max(flight_s, 0.0), slot_known=known)

    def is_member(self, flight_s: float) -> bool:
        """True if the vehicle belongs to the formation by the scenario: it has joined, and has not left."""
        begin_ns, end_ns = (
            joins_ns(self._scenario, self._uav_id),
            leaves_ns(self._scenario, self._uav_id),
        )
        return begin_ns <= flight_s * NANOSECONDS < end_ns

    def places(self, flight_s: float) -> Array | None:
        """The places (K, 3) [m] that the vehicle may have to take where UAVs come and go; None elsewhere."""
        scenario = self._scenario
        if not scenario.formation.reconfigures:
            return None
        closes_up = scenario.formation.vacancy == "close_up"
        slots = scenario.uav_ids if closes_up else (self._uav_id,)
        leader = np.array(self.at(flight_s).position)
        return leader + np.array([scenario.offset(slot) for slot in slots])

    def _flown(self) -> Scenario:
        return self._epochs.scenario or self._scenario


def place_velocity(config: AgentConfig, t: float, *, slot_known: bool) -> Array:
    """Velocity (3,) [m/s] of a UAV's place at t [s]: that of the leader's reference, and that of a shape that moves.

    Where slots are open a bridge does not hear who takes which, and the leader's has to do.
    """
    velocity = np.array(reference(config.trajectory, t).velocity)
    if config.shape.moving and slot_known:
        velocity += places(config.shape, config.trajectory, t).own.velocity
    return velocity
