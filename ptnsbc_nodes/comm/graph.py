"""The edges of a scenario: the senders that each UAV hears, and the number of nodes that read each topic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_sim.disturbances.links import LinkDelay, MessageLoss, link_delay, message_loss
from ptnsbc_sim.scenario import Scenario, SeveralParents, several_parents
from ptnsbc_sim.scenario.mission.faults import FaultBlock
from ptnsbc_sim.scenario.slots import Slots, are_open, with_slots

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
    peers: tuple[
        int, ...
    ] = ()  # UAVs whose state is needed besides: by the law, or to see which are there
    several: SeveralParents | None = None  # the parents of a UAV with more than one
    every_tick: bool = False  # lock-step waits for all that it subscribes to, used or not
    losses: MessageLoss | None = None  # which of their messages the scenario wants lost
    delays: Mapping[int, LinkDelay] = field(default_factory=dict)  # and how late, by sender
    faults: tuple[FaultBlock, ...] | None = None  # of the scenario; None: none can be injected
    period_ns: int = 0  # control period

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
        others = [i for i in scenario.uav_ids if i != uav_id]
        return Senders(
            parent=scenario.communication.parent(uav_id),
            leader=scenario.leader.id if uav_id in scenario.topology.pinned else None,
            estimators=scenario.topology.neighbours.get(uav_id, ()),
            others=self._others(uav_id) if self._reassigns() else (),
            peers=self._peers(uav_id),
            several=several_parents(scenario, uav_id),
            every_tick=scenario.formation.reconfigures,
            losses=message_loss(scenario, uav_id),
            delays={i: link_delay(scenario, i, uav_id) for i in others},
            faults=scenario.faults,
            period_ns=scenario.timing.dt_ns,
        )

    def holding(self, slots: Slots) -> CommunicationGraph:
        """The graph in which every UAV has the edges of its slot."""
        return self.of(with_slots(self._scenario, slots))

    def of(self, scenario: Scenario) -> CommunicationGraph:
        """The graph of another scenario, flown with the same options."""
        return CommunicationGraph(scenario, self.options)

    def _reassigns(self) -> bool:
        """True if a UAV may get another slot, and the edges of that slot. Otherwise it only loses edges."""
        return are_open(self._scenario) or self._scenario.formation.vacancy == "close_up"

    def _peers(self, uav_id: int) -> tuple[int, ...]:
        if self._scenario.formation.reconfigures:
            return self._others(uav_id)
        return (
            () if self._scenario.law is None else self._scenario.topology.neighbours.get(uav_id, ())
        )

    def _others(self, uav_id: int) -> tuple[int, ...]:
        """UAVs, ascending, that this one may have to hear later, when slots are assigned or UAVs come and go."""
        if not are_open(self._scenario) and not self._scenario.formation.reconfigures:
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

    def state_readers(self, uav_id: int) -> int:
        """The number of nodes that read the formation_state of this UAV."""
        heard = sum(uav_id in self.senders(other).heard_states for other in self._scenario.uav_ids)
        return heard + self.options.recorders

    def estimate_readers(self, uav_id: int) -> int:
        """The number of nodes that read the leader_estimate of this UAV."""
        heard = sum(
            uav_id in self.senders(other).heard_estimators for other in self._scenario.uav_ids
        )
        return heard + self.options.recorders

    def odometry_readers(self, uav_id: int) -> int:
        """The number of nodes that read the odometry of this UAV; with open slots the UAV that decides them is one."""
        decides = are_open(self._scenario) and uav_id != self._scenario.leader.id
        return 1 + decides + self.options.recorders

    def wrench_readers(self) -> int:
        """The number of nodes that read a wrench; in real time a bridge may fly instead of the sim."""
        return int(self.options.lockstep) + self.options.recorders

    def epoch_readers(self) -> int:
        """The number of nodes that read the epoch: all UAVs, in lock-step also the sim; not every flight has one."""
        return len(self._scenario.uav_ids) + self.wrench_readers()

    def slots_readers(self) -> int:
        """The number of nodes that read the slots: all UAVs."""
        return len(self._scenario.uav_ids) + self.options.recorders

    def epoch_listeners(self) -> dict[int, int]:
        """The number of nodes of each UAV that read the epoch: its controller, and its bridge."""
        return dict.fromkeys(self._scenario.uav_ids, 1 + self.options.bridged)
