"""Slots of the formation: who takes which, and the graph and the slots that are left when a UAV comes or goes.

A slot is a place of the formation with all that belongs to it: its offset from the leader, its parent, its links and
its task. It has the number of the UAV to which the scenario gives it. With `formation.assignment: optimal` the UAVs
take the slots so that the sum of the squared distances to them is minimal. Mass, noise, ports and keep-out stay with
the UAV.

Every UAV hears all others and applies the same rule to what it hears, so no messages are needed to agree on members. A
UAV is *absent* before it joins, after it has left, and when it has been silent for longer than
`communication.stale_s`. One that was absent and has *returned* takes a slot again, but nobody's parent and not the
lead.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.topology import Topology, estimator_matrix, validated_topology
from ptnsbc_core.types import NEVER_RECEIVED_S, Array
from ptnsbc_sim.scenario.fields import replaced
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.scenario.mission.shapes import nearest_places
from ptnsbc_sim.scenario.scenario import Scenario

Slots = Mapping[int, int]
"""Slot of every UAV."""


class SlotsError(PtnsbcError):
    """An assignment of slots that no fleet can fly."""


def optimal_slots(
    scenario: Scenario, positions: Mapping[int, Array], t: float = 0.0
) -> dict[int, int]:
    """The slots for which the sum of the squared distances from the positions to them is minimal.

    The positions are (3,) [m], ENU, of every UAV at time t [s] since the first epoch: a shape may move.

    Raises:
        SlotsError: the position of a UAV is missing or not finite.
    """
    ids = scenario.uav_ids
    for uav in ids:
        if uav not in positions or not np.isfinite(positions[uav]).all():
            raise SlotsError(f"slots: no finite position of UAV {uav}: expected one of every UAV")
    starts = np.stack([positions[uav] for uav in ids])
    places = np.concatenate([places_beside_leader(scenario, uav, np.array([t])) for uav in ids])
    order = nearest_places(starts, places, centred=True)
    return {uav: ids[int(row)] for uav, row in zip(ids, order, strict=True)}


def require_slots(scenario: Scenario, slots: Slots) -> None:
    """Raise SlotsError unless `slots` gives every UAV a slot of its own."""
    ids = set(scenario.uav_ids)
    if odd := ids.symmetric_difference(slots):
        odd_ids = ", ".join(map(str, sorted(odd)))
        raise SlotsError(
            f"slots of {len(slots)} UAVs: expected those of {len(ids)}; look at UAV {odd_ids}"
        )
    if odd := ids.symmetric_difference(slots.values()):
        odd_ids = ", ".join(map(str, sorted(odd)))
        raise SlotsError(
            f"slots: no UAV or more than one takes slot {odd_ids}: expected one UAV for each"
        )


def with_slots(scenario: Scenario, slots: Slots) -> Scenario:
    """The scenario in which every UAV has the offset, the links and the task of its slot.

    Its `text` stays that of the whole flight: a later epoch may decide anew.

    Raises:
        SlotsError: not every UAV has a slot of its own.
    """
    require_slots(scenario, slots)
    holder = {slot: uav for uav, slot in slots.items()}
    if all(uav == slot for uav, slot in slots.items()):
        return scenario
    links, formation = scenario.communication, scenario.formation

    def held(offsets_m: Mapping[int, Any] | None) -> dict[int, Any] | None:
        return None if offsets_m is None else {holder[k]: at for k, at in offsets_m.items()}

    keys = {
        "communication.tree": {holder[child]: holder[above] for child, above in links.tree.items()},
        "communication.leader_links": tuple(holder[slot] for slot in links.leader_links),
        "communication.estimator_edges": tuple(
            (holder[a], holder[b]) for a, b in links.estimator_edges
        ),
        "leader.id": holder[scenario.leader.id],
        "formation.offsets_m": held(formation.offsets_m),
        "formation.changes": tuple(
            replaced(change, {"offsets_m": held(change.offsets_m)}) for change in formation.changes
        ),
        "topology": _topology_of(scenario.topology, holder),
    }
    return replaced(scenario, keys)


def with_slots_of_starts(scenario: Scenario) -> Scenario:
    """The scenario with the slots of its starts; as it is, where every UAV has its own."""
    if not scenario.formation.has_open_slots:
        return scenario
    starts = {uav: scenario.uav(uav).position for uav in scenario.uav_ids}
    return with_slots(scenario, optimal_slots(scenario, starts))


def _topology_of(topology: Topology, holder: Mapping[int, int]) -> Topology:
    """The same graph on other UAVs; its eigenvalues stay, to the last bit."""
    leader = holder[topology.leader]
    pinned = frozenset(holder[slot] for slot in topology.pinned)
    neighbours = {
        holder[slot]: tuple(sorted(holder[other] for other in others))
        for slot, others in topology.neighbours.items()
    }
    followers = [uav for uav in topology.order if uav != leader]
    return topology._replace(
        leader=leader,
        parent={holder[child]: holder[above] for child, above in topology.parent.items()},
        pinned=pinned,
        neighbours=neighbours,
        matrix=estimator_matrix(followers, pinned, neighbours),
        depth={holder[slot]: hops for slot, hops in topology.depth.items()},
    )


class Membership(NamedTuple):
    """The UAVs that are absent or have returned, as one UAV sees it."""

    absent: frozenset[int]
    returned: frozenset[int]  # that are there, and were absent before


class View:
    """The members as one UAV finds them, from the start of its process on."""

    def __init__(self, scenario: Scenario, uav_id: int) -> None:
        self._uav = uav_id
        self._spans = {uav.id: (uav.joins_ns, uav.leaves_ns) for uav in scenario.uavs}
        self._stale_s = float(scenario.communication.stale_s)
        self._away: set[int] = set()

    def pause(self, gap_ns: int) -> None:
        """The UAV has not stepped for so long [ns]: for the others it was lost, if that is too long."""
        if seconds(gap_ns) > self._stale_s:
            self._away.add(self._uav)

    def at(self, since_ns: int, awake_ns: int, ages_s: Mapping[int, float]) -> Membership:
        """The members at this tick; to be called at every tick in turn.

        Args:
            since_ns: time since the first epoch [ns].
            awake_ns: the same since the first step of this process, if that was later.
            ages_s: ages [s] of the newest states of the others, NEVER_RECEIVED_S without one.
        """
        early = seconds(awake_ns) <= self._stale_s
        if seconds(since_ns - awake_ns) > self._stale_s:
            self._away.add(self._uav)
        absent = set()
        for uav, (joins, leaves) in self._spans.items():
            age_s = 0.0 if uav == self._uav else ages_s[uav]
            silent = age_s > self._stale_s and not (early and age_s >= NEVER_RECEIVED_S)
            if silent or not joins <= since_ns < leaves:
                absent.add(uav)
        self._away |= absent
        return Membership(frozenset(absent), frozenset(self._away - absent))


class Formations:
    """The scenario with the graph of the members; every graph that was computed is kept."""

    def __init__(self, scenario: Scenario) -> None:
        import scipy.sparse.csgraph  # noqa: F401 - before the flight: no tick waits half a second for it

        self.scenario = scenario
        self._known: dict[Membership, Scenario | None] = {}

    def of(self, members: Membership) -> Scenario | None:
        """The scenario with the graph and the slots of these members; None while nobody can lead."""
        if not members.absent and not members.returned:
            return self.scenario
        if members not in self._known:
            self._known[members] = reconfigured(self.scenario, members)
        return self._known[members]


def reconfigured(scenario: Scenario, members: Membership) -> Scenario | None:
    """The scenario as the members fly it; None while nobody of those who may lead is there.

    The leader is the first in the line of succession that was never absent, else the first that is there. The parent
    is the nearest one above in the tree that was never absent, else the leader. Of the followers that no estimate of
    the leader would reach, the one with the smallest id in each connected part hears the leader itself.
    """
    line = [scenario.leader.id, *scenario.leader.successors]
    there = [uav for uav in line if uav not in members.absent]
    steady = [uav for uav in there if uav not in members.returned]
    if not there:
        return None
    leader = (steady or there)[0]
    if scenario.formation.vacancy == "close_up":
        scenario = with_slots(scenario, _closed_up(scenario, members, leader))
    links, absent = scenario.communication, members.absent
    followers = [uav for uav in scenario.uav_ids if uav not in absent and uav != leader]
    unfit = absent | members.returned
    tree = {uav: _parent(links.tree, uav, unfit, leader) for uav in followers}
    edges = tuple(edge for edge in links.estimator_edges if set(edge) <= set(followers))
    pinned = {uav for uav in links.leader_links if uav in followers}
    pinned |= set(_unreached(followers, edges, pinned))
    keys = {
        "communication.tree": tree,
        "communication.leader_links": tuple(sorted(pinned)),
        "communication.estimator_edges": edges,
        "leader.id": leader,
        "topology": validated_topology(leader, [leader, *followers], tree, sorted(pinned), edges),
    }
    return replaced(scenario, keys)


def _parent(tree: Mapping[int, int], uav: int, unfit: frozenset[int], leader: int) -> int:
    above = tree.get(uav)
    while above is not None and above in unfit:
        above = tree.get(above)
    return leader if above is None else above


def _unreached(
    followers: Sequence[int], edges: Sequence[tuple[int, int]], pinned: Collection[int]
) -> Iterator[int]:
    """The smallest id of each connected part of the estimator graph in which nobody hears the leader."""
    from scipy.sparse.csgraph import connected_components  # late: half a second

    linked = np.zeros((len(followers), len(followers)))
    for uav, other in edges:
        linked[followers.index(uav), followers.index(other)] = 1.0
    count, parts = connected_components(linked, directed=False)
    for part in range(count if followers else 0):
        inside = [uav for uav, number in zip(followers, parts, strict=True) if number == part]
        if not set(pinned).intersection(inside):
            yield min(inside)


def _closed_up(scenario: Scenario, members: Membership, leader: int) -> dict[int, int]:
    """The slot of every UAV when those behind an empty slot move up, each into the slot above its own.

    Of several behind it the one moves up that has the longest line behind it, of those the one with the smallest id.
    The deepest slots are closed first, so an empty slot ends at the end of a line, whatever the order of the losses.
    """
    root, tree = scenario.leader.id, scenario.communication.tree
    depth = scenario.topology.depth
    lowest = dict(depth)  # hops of the deepest slot below each
    for slot, hops in depth.items():
        above = tree.get(slot)
        while above is not None:
            lowest[above] = max(lowest[above], hops)
            above = tree.get(above)
    empty = set(members.absent) | ({root} if leader != root else set())
    holder = {slot: slot for slot in depth}

    def move_up(slot: int) -> None:
        behind = [one for one, above in tree.items() if above == slot and holder[one] not in empty]
        if behind:
            chosen = min(behind, key=lambda one: (-lowest[one], one))
            holder[slot], holder[chosen] = holder[chosen], holder[slot]
            move_up(chosen)

    for slot in sorted(depth, key=lambda one: (-depth[one], one)):
        if slot != root and holder[slot] in empty:
            move_up(slot)
    if leader != root:
        of_leader = next(slot for slot, uav in holder.items() if uav == leader)
        holder[root], holder[of_leader] = holder[of_leader], holder[root]
        move_up(of_leader)
    return {uav: slot for slot, uav in holder.items()}


def changed(before: Scenario, after: Scenario, uav_id: int) -> tuple[bool, bool]:
    """True if a UAV has another place in the graph: another parent, slot or lead of its own, and another leader.

    A UAV that no longer hears the leader takes none: the last one that it was told would count for ever.
    """
    leads = (before.leader.id == uav_id) != (after.leader.id == uav_id)
    parents = before.communication.parent(uav_id), after.communication.parent(uav_id)
    moved = before.offset(uav_id).tolist() != after.offset(uav_id).tolist()
    hears = (uav_id in before.topology.pinned) != (uav_id in after.topology.pinned)
    led = before.leader.id != after.leader.id or hears
    return leads or parents[0] != parents[1] or moved, led
