"""The communication graph: a spanning tree rooted at the leader, and the matrix H of the leader estimator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ptnsbc_core.errors import TopologyError
from ptnsbc_core.types import Array


class Topology(NamedTuple):
    """A validated graph. Ids are the UAV numbers of the scenario."""

    leader: int
    order: tuple[int, ...]  # ids, ascending
    parent: Mapping[int, int]  # follower: parent
    pinned: frozenset[int]  # followers that receive the leader's state
    neighbours: Mapping[int, tuple[int, ...]]  # follower: in the estimator graph, ascending
    matrix: Array  # (n, n) H = L_FF + diag(b), followers ascending
    lambda_min: float
    lambda_max: float
    depth: Mapping[int, int]  # hops from the leader


def validated_topology(
    leader: int,
    uavs: Sequence[int],
    tree: Mapping[int, int],
    leader_links: Sequence[int],
    estimator_edges: Sequence[tuple[int, int]],
) -> Topology:
    """Check the graph and derive H, its eigenvalues and the depth of every UAV.

    Args:
        leader: id of the leader.
        uavs: all ids, each once, the leader among them.
        tree: child to parent, of these ids.
        leader_links: followers that receive the leader's state.
        estimator_edges: undirected edges between followers over which leader estimates travel.

    Raises:
        TopologyError: a cycle, a UAV without a path to the leader or to its state, a link of no follower.
    """
    followers = sorted(uav for uav in uavs if uav != leader)
    if leader in tree:
        raise TopologyError(
            f"communication.tree.{leader}: the leader has parent {tree[leader]}: it is the root, drop the entry"
        )
    if odd := set(leader_links).difference(followers):
        raise TopologyError(
            f"communication.leader_links: {min(odd)} is no follower: expected ids out of {followers}"
        )
    depth = {uav: _depth(uav, leader, tree) for uav in uavs}
    pinned = frozenset(leader_links)
    neighbours = _neighbours(followers, estimator_edges)
    _check_reach(followers, pinned, neighbours)
    matrix = estimator_matrix(followers, pinned, neighbours)
    eigenvalues = np.linalg.eigvalsh(matrix) if followers else np.ones(1)
    return Topology(
        leader,
        tuple(sorted(uavs)),
        dict(tree),
        pinned,
        neighbours,
        matrix,
        float(eigenvalues[0]),
        float(eigenvalues[-1]),
        depth,
    )


def estimator_matrix(
    followers: Sequence[int], pinned: frozenset[int], neighbours: Mapping[int, tuple[int, ...]]
) -> Array:
    """H = L_FF + diag(b), (n, n), rows in the order of `followers`."""
    index = {uav: row for row, uav in enumerate(followers)}
    matrix = np.zeros((len(followers), len(followers)))
    for uav in followers:
        row = index[uav]
        matrix[row, row] = len(neighbours[uav]) + (uav in pinned)
        for other in neighbours[uav]:
            matrix[row, index[other]] = -1.0
    return matrix


def _depth(uav: int, leader: int, tree: Mapping[int, int]) -> int:
    seen = [uav]
    while seen[-1] != leader:
        parent = tree.get(seen[-1])
        if parent is None:
            raise TopologyError(
                f"communication.tree: UAV {uav} has no path to the leader {leader}: "
                f"{seen[-1]} has no parent, add '{seen[-1]}: <parent>'"
            )
        if parent in seen:
            cycle = " -> ".join(str(node) for node in [*seen[seen.index(parent) :], parent])
            raise TopologyError(
                f"communication.tree: cycle {cycle}: give one of them a parent on the leader's side"
            )
        seen.append(parent)
    return len(seen) - 1


def _neighbours(
    followers: Sequence[int], edges: Sequence[tuple[int, int]]
) -> dict[int, tuple[int, ...]]:
    linked: dict[int, set[int]] = {uav: set() for uav in followers}
    for a, b in edges:
        if a not in linked or b not in linked or a == b:
            raise TopologyError(
                f"communication.estimator_edges: [{a}, {b}] does not join two followers out of {list(followers)}"
            )
        linked[a].add(b)
        linked[b].add(a)
    return {uav: tuple(sorted(others)) for uav, others in linked.items()}


def _check_reach(
    followers: Sequence[int], pinned: frozenset[int], neighbours: Mapping[int, tuple[int, ...]]
) -> None:
    """Every follower must receive the leader's state directly or through estimates, or H is singular."""
    reached = set(pinned)
    frontier = list(pinned)
    while frontier:
        for other in neighbours[frontier.pop()]:
            if other not in reached:
                reached.add(other)
                frontier.append(other)
    for uav in followers:
        if uav not in reached:
            raise TopologyError(
                f"communication: UAV {uav} never learns of the leader: add it to leader_links, "
                "or an estimator edge to a UAV that does"
            )
