"""The edges of a scenario: the senders that each UAV hears, and the number of nodes that read each topic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.topics import Topic
from ptnsbc_sim.disturbances.links import Link, link_of
from ptnsbc_sim.disturbances.random_streams import ESTIMATE_LINK, STATE_LINK
from ptnsbc_sim.scenario import Scenario, SeveralParents, several_parents
from ptnsbc_sim.scenario.mission.fault_rules import FaultBlock

LEAD_TICKS = 4
"""In lock-step a vehicle is at most this many ticks ahead of the slowest: bounds what an inbox keeps."""


@dataclass(frozen=True)
class FlightOptions:
    """The options of a flight; the same for all its processes."""

    lockstep: bool = False
    recorded: bool = False  # a recorder must hear every topic before the flight
    bridged: bool = False  # flight controllers instead of the sim
    seal: Seal | None = None  # of the fleet, where the scenario requires one

    @property
    def recorders(self) -> int:
        """Readers that the recorder adds to each topic."""
        return int(self.recorded)


@dataclass(frozen=True)
class Senders:
    """The senders that one UAV listens to: the edges of the graph that end at it."""

    parent: int | None
    leader: int | None  # None unless pinned
    estimators: tuple[int, ...]  # ascending: the order of the rows of AgentInputs.estimates
    others: tuple[int, ...] = ()  # all other UAVs, where the edges of any of them may be needed
    peers: tuple[int, ...] = ()  # whose state is needed besides: by the law, or to see who is there
    several: SeveralParents | None = None  # the parents of a UAV with more than one
    every_tick: bool = False  # lock-step waits for all that it subscribes to, used or not
    links: Mapping[tuple[int, int], Link] = field(default_factory=dict)  # by kind and sender
    faults: tuple[FaultBlock, ...] = ()  # of the scenario

    @property
    def states(self) -> tuple[int, ...]:
        """UAVs whose formation_state is needed; a child of the leader subscribes once."""
        tree = {i for i in (self.parent, self.leader) if i is not None}
        several = () if self.several is None else self.several.ids
        return tuple(sorted(tree.union(self.peers, several)))

    @property
    def heard_states(self) -> tuple[int, ...]:
        """UAVs to whose formation_state this one subscribes."""
        return self.others or self.states

    @property
    def heard_estimators(self) -> tuple[int, ...]:
        """UAVs to whose leader_estimate this one subscribes."""
        return self.others or self.estimators


class CommunicationGraph:
    """The communication graph of one flight, seen from its topics."""

    def __init__(self, scenario: Scenario, options: FlightOptions) -> None:
        self._scenario = scenario
        self.options = options

    def senders(self, uav_id: int) -> Senders:
        """The senders that this UAV listens to."""
        scenario = self._scenario
        # A UAV may get another slot, and the edges of that slot; otherwise it only loses edges.
        reassigns = scenario.formation.has_open_slots or scenario.formation.vacancy == "close_up"
        others = [i for i in scenario.uav_ids if i != uav_id]
        neighbours = scenario.topology.neighbours.get(uav_id, ())
        peers = neighbours if scenario.law is not None else ()
        if scenario.formation.reconfigures:
            peers = self._others(uav_id)
        return Senders(
            parent=scenario.communication.parent(uav_id),
            leader=scenario.leader.id if uav_id in scenario.topology.pinned else None,
            estimators=neighbours,
            others=self._others(uav_id) if reassigns else (),
            peers=peers,
            several=several_parents(scenario, uav_id),
            every_tick=scenario.formation.reconfigures,
            links={
                (kind, i): link_of(scenario, kind, uav_id, i)
                for kind in (STATE_LINK, ESTIMATE_LINK)
                for i in others
            },
            faults=scenario.faults,
        )

    def of(self, scenario: Scenario) -> CommunicationGraph:
        """The graph of another scenario, flown with the same options."""
        return CommunicationGraph(scenario, self.options)

    def _others(self, uav_id: int) -> tuple[int, ...]:
        """UAVs, ascending, that this one may have to hear later, when slots are assigned or UAVs come and go."""
        formation = self._scenario.formation
        if not (formation.has_open_slots or formation.reconfigures):
            return ()
        return tuple(sorted(i for i in self._scenario.uav_ids if i != uav_id))

    def linked(self, uav_id: int) -> tuple[int, ...]:
        """UAVs that this one has an edge with, in either direction, ascending; all where any may be needed."""
        if others := self._others(uav_id):
            return others
        all_senders = {i: self.senders(i) for i in self._scenario.uav_ids}
        heard = {i: {*one.states, *one.estimators} for i, one in all_senders.items()}
        edged = (i for i in heard if i in heard[uav_id] or uav_id in heard[i])
        return tuple(sorted(set(edged) - {uav_id}))

    def heard_by(self, uav_id: int) -> tuple[Topic, ...]:
        """The topics of a flight that the controller of a UAV reads."""
        scenario, senders = self._scenario, self.senders(uav_id)
        decides = scenario.formation.has_open_slots and uav_id == scenario.leader.id
        return (
            *map(topics.odom, scenario.uav_ids if decides else (uav_id,)),
            *(topics.near(uav_id), topics.EPOCH),
            *((topics.SLOTS,) if scenario.formation.has_open_slots else ()),
            *map(topics.formation_state, senders.heard_states),
            *map(topics.leader_estimate, senders.heard_estimators),
        )

    def readers(self, topic: Topic) -> int:
        """The number of nodes that must read a recorded topic before the flight.

        In real time a bridge may fly instead of the sim, and then the sim is none of them.
        """
        by_sim = (topics.EPOCH, *map(topics.wrench_setpoint, self._scenario.uav_ids))
        sim = self.options.lockstep and topic in by_sim
        return sum(topic in heard for heard in self._heard) + sim + self.options.recorders

    @cached_property
    def _heard(self) -> list[tuple[Topic, ...]]:
        return [self.heard_by(uav) for uav in self._scenario.uav_ids]
