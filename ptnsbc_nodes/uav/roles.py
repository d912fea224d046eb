"""The place of one UAV in a graph that changes when UAVs come and go. No ROS in here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from ptnsbc_core.types import MODE_FORMATION, NEVER_RECEIVED_S, AgentConfig
from ptnsbc_nodes.comm.graph import CommunicationGraph, Senders
from ptnsbc_sim.roles import RoleChange
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.mission.membership import Formations, Membership, View


class NewRole(NamedTuple):
    """The role that a UAV has from this step on."""

    change: RoleChange
    config: AgentConfig
    senders: Senders


class RoleHolder:
    """The role of one UAV, by the members that it sees.

    Args:
        scenario: of the flight; UAVs may come and go in it.
        uav_id: the UAV.
        edges: the communication graph of the scenario.
    """

    def __init__(self, scenario: Scenario, uav_id: int, edges: CommunicationGraph) -> None:
        self.uav = uav_id
        self._edges = edges
        self.follow(scenario)
        self.restart()

    def restart(self) -> None:
        """Forget the members seen so far."""
        self._view = View(self._formations.scenario, self.uav)
        self._began_ns: int | None = None
        self._looked_ns: int | None = None
        self._before: Scenario | None = self._formations.scenario
        self._members = Membership(frozenset(), frozenset())

    def follow(self, scenario: Scenario) -> None:
        """Fly by the mission as it goes on after a word."""
        self._formations = Formations(scenario)

    def flown(self) -> Scenario:
        """The scenario with the present graph."""
        self._before = self._formations.of(self._members) or self._formations.scenario
        return self._before

    @property
    def leads(self) -> bool:
        """True if the UAV leads by the members that it sees."""
        return self._before is not None and self._before.leader.id == self.uav

    def holds(self, mode: int) -> bool:
        """True if the UAV has to hold in a leg, because it is no member yet."""
        return mode == MODE_FORMATION and self.uav in self._members.absent

    def look(self, now_ns: int, first_t0_ns: int, ages_s: Mapping[int, float]) -> NewRole | None:
        """Determine the members at a step; returns the new role of the UAV if it changes.

        Args:
            now_ns: the instant of the step [ns].
            first_t0_ns: the first epoch [ns].
            ages_s: ages [s] of the newest states that were received, by sender.
        """
        scenario = self._formations.scenario
        if self._began_ns is None:
            self._began_ns = max(now_ns, first_t0_ns)
        if self._looked_ns is not None:
            self._view.pause(now_ns - self._looked_ns)
        self._looked_ns = now_ns
        others = (uav for uav in scenario.uav_ids if uav != self.uav)
        ages = {uav: ages_s.get(uav, NEVER_RECEIVED_S) for uav in others}
        self._members = self._view.at(now_ns - first_t0_ns, now_ns - self._began_ns, ages)
        after = self._formations.of(self._members)
        if self.uav in self._members.absent:
            self._before = None
            return None
        if after is None or after is self._before:
            return None
        change = RoleChange(self.uav, self._before, after)
        self._before = after
        senders = self._edges.of(after).senders(self.uav)
        return NewRole(change, agent_config(after, self.uav), senders)


def role_holder(scenario: Scenario, uav_id: int, edges: CommunicationGraph) -> RoleHolder | None:
    """The role of a UAV where UAVs may come and go, else None."""
    return RoleHolder(scenario, uav_id, edges) if scenario.formation.reconfigures else None
