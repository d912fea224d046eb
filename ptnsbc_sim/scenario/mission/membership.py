"""Members of the formation, and the graph and the slots that the formation has when a UAV comes or goes.

Every UAV hears all others and applies the same rule to what it hears, so no messages are needed to agree: see
docs/method.md, "Coming and going". A UAV is *absent* before it joins, after it has left, and when it has been silent
for longer than `communication.stale_s`. One that was absent and has *returned* takes a slot again, but nobody's
parent and not the lead.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ptnsbc_core.topology import validated_topology
from ptnsbc_core.types import NEVER_RECEIVED_S
from ptnsbc_sim.scenario.scenario import Scenario
from ptnsbc_sim.scenario.slots import with_slots

_NANO = 1e9
NEVER_NS = 2**62


class Membership(NamedTuple):
    """The UAVs that are absent or have returned, as one UAV sees it."""

    absent: frozenset[int]
    returned: frozenset[int]  # that are there, and were absent before


class GraphPlace(NamedTuple):
    """The place of one UAV in the graph."""

    leader: int
    parent: int | None
    slot: tuple[float, ...]  # [m, ENU]
    pinned: bool  # it hears the leader


def joins_ns(scenario: Scenario, uav_id: int) -> int:
    """The time at which a UAV joins, after the first epoch [ns]; 0: it is there from the begin on."""
    joins_s = next(uav.joins_s for uav in scenario.uavs if uav.id == uav_id)
    return 0 if joins_s is None else round(joins_s * _NANO)


def leaves_ns(scenario: Scenario, uav_id: int) -> int:
    """The time at which a UAV leaves, after the first epoch [ns]."""
    leaves_s = next(uav.leaves_s for uav in scenario.uavs if uav.id == uav_id)
    return NEVER_NS if leaves_s is None else round(leaves_s * _NANO)


class View:
    """The members as one UAV finds them, from the start of its process on."""

    def __init__(self, scenario: Scenario, uav_id: int) -> None:
        self._uav = uav_id
        self._spans = {
            uav: (joins_ns(scenario, uav), leaves_ns(scenario, uav)) for uav in scenario.uav_ids
        }
        self._stale_s = float(scenario.communication.stale_s)
        self._away: set[int] = set()

    def pause(self, gap_ns: int) -> None:
        """The UAV has not stepped for so long [ns]: for the others it was lost, if that is too long."""
        if gap_ns * 1e-9 > self._stale_s:
            self._away.add(self._uav)

    def at(self, since_ns: int, awake_ns: int, ages_s: Mapping[int, float]) -> Membership:
        """The members at this tick; to be called at every tick in turn.

        Args:
            since_ns: time since the first epoch [ns].
            awake_ns: the same since the first step of this process, if that was later.
            ages_s: ages [s] of the newest states of the others, NEVER_RECEIVED_S without one.
        """
        early = awake_ns * 1e-9 <= self._stale_s
        if (since_ns - awake_ns) * 1e-9 > self._stale_s:
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


def role_of(scenario: Scenario, uav_id: int) -> GraphPlace:
    """The role of a UAV in a formation."""
    slot = tuple(scenario.offset(uav_id).tolist())
    return GraphPlace(
        scenario.leader.id,
        scenario.communication.parent(uav_id),
        slot,
        uav_id in scenario.topology.pinned,
    )


def reconfigured(scenario: Scenario, members: Membership) -> Scenario | None:
    """The scenario as the members fly it; None while nobody of those who may lead is there.

    The leader is the first in the line of succession that was never absent, else the first that is there. The parent
    is the nearest one above in the tree that was never absent, else the leader. Of the followers that no estimate of
    the leader would reach, the one with the smallest id in each connected part hears the leader itself.
    """
    leader = _leader(scenario, members)
    if leader is None:
        return None
    if scenario.formation.vacancy == "close_up":
        scenario = with_slots(scenario, _closed_up(scenario, members, leader))
    links, absent = scenario.communication, members.absent
    followers = [uav for uav in scenario.uav_ids if uav not in absent and uav != leader]
    unfit = absent | members.returned
    tree = {uav: _parent(links.tree, uav, unfit, leader) for uav in followers}
    edges = tuple(edge for edge in links.estimator_edges if set(edge) <= set(followers))
    pinned = {uav for uav in links.leader_links if uav in followers}
    pinned |= set(_unreached(followers, edges, pinned))
    block = links.model_copy(
        update={"tree": tree, "leader_links": tuple(sorted(pinned)), "estimator_edges": edges}
    )
    update = {
        "communication": block,
        "leader": scenario.leader.model_copy(update={"id": leader}),
        "topology": validated_topology(leader, [leader, *followers], tree, sorted(pinned), edges),
    }
    return scenario.model_copy(update=update)


def _leader(scenario: Scenario, members: Membership) -> int | None:
    line = [scenario.leader.id, *scenario.leader.successors]
    there = [uav for uav in line if uav not in members.absent]
    steady = [uav for uav in there if uav not in members.returned]
    return next(iter([*steady, *there]), None)


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
    for one, other in edges:
        linked[followers.index(one), followers.index(other)] = 1.0
    count, parts = connected_components(linked, directed=False)
    for part in range(count if followers else 0):
        inside = [uav for uav, own in zip(followers, parts, strict=True) if own == part]
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
    was, now = role_of(before, uav_id), role_of(after, uav_id)
    leads = (was.leader == uav_id) != (now.leader == uav_id)
    led = was.leader != now.leader or was.pinned != now.pinned
    return leads or was.parent != now.parent or was.slot != now.slot, led
