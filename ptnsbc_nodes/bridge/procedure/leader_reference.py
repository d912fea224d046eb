"""The motion of the leader as one bridge follows it: the legs that are announced, and its trajectory."""

from __future__ import annotations

from ptnsbc_core.curves.trajectory import Reference, reference
from ptnsbc_nodes.bridge.ports import BridgeInputs
from ptnsbc_nodes.comm.legs import Epochs, Leg
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.build import leader_trajectory


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
        """The leg in force; None before the first."""
        return self._epochs.at(now_ns)

    def flight_s(self, now_ns: int) -> float:
        """Time since the first epoch; negative before it."""
        leg = self.leg(now_ns)
        return -1.0 if leg is None else (now_ns - leg.first_t0_ns) * 1e-9

    def at(self, flight_s: float) -> Reference:
        """The leader's motion so many seconds after the first epoch; before it, that of the epoch."""
        return reference(self.config.trajectory, max(flight_s, 0.0))

    def _flown(self) -> Scenario:
        return self._epochs.scenario or self._scenario
