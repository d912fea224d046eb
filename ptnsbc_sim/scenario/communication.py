"""The communication of a scenario: checks of the tree, the links and the parents, and the graph that they make."""

from __future__ import annotations

import math
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter

from ptnsbc_core.errors import GainError, TopologyError
from ptnsbc_core.timebase import peak_gain
from ptnsbc_core.topology import Topology, validated_topology
from ptnsbc_sim.scenario.mission import legs, shapes
from ptnsbc_sim.scenario.model import ScenarioFile

STABILITY_LIMIT = 2.0
"""An explicit Euler step of a linear decay with rate g is stable for dt g below this."""

_WEIGHTS_SUM = 1e-6

Problems = Iterator[str]


def problems(file: ScenarioFile) -> Problems:
    """Contradictions among tree, links and parents."""
    yield from _members(file)
    yield from _links(file)
    yield from _parents(file)


def _members(file: ScenarioFile) -> Problems:
    ids = {uav.id for uav in file.uavs}
    known = "expected one of the ids under uavs: " + ", ".join(map(str, sorted(ids)))
    if file.leader.id not in ids:
        yield f"leader.id: {file.leader.id}: no start under uavs; {known}"
    links = file.communication
    for child, parent in links.tree.items():
        if child not in ids:
            yield f"communication.tree.{child}: no UAV {child}, its start is missing; {known}"
        elif parent not in ids:
            yield f"communication.tree.{child}: {parent}: no such UAV; {known}"
    for index, uav in enumerate(links.leader_links):
        if uav not in ids:
            yield f"communication.leader_links[{index}]: {uav}: no such UAV; {known}"
    for index, edge in enumerate(links.estimator_edges):
        for end, uav in enumerate(edge):
            if uav not in ids:
                yield f"communication.estimator_edges[{index}][{end}]: {uav}: no such UAV; {known}"


def _links(file: ScenarioFile) -> Problems:
    block = file.communication
    first: dict[tuple[int, int], int] = {}
    for index, link in enumerate(block.links):
        where, ends = f"communication.links[{index}]", (link.sender, link.receiver)
        pair = {ends, ends[::-1]}
        if not (
            block.tree.get(link.receiver) == link.sender
            or link.sender in (block.parents or {}).get(link.receiver, ())
            or (link.sender == file.leader.id and link.receiver in block.leader_links)
            or pair.intersection(block.estimator_edges)
        ):
            yield (
                f"{where}: no messages from UAV {link.sender} to UAV {link.receiver}: expected an edge "
                "of communication.tree, parents, leader_links or estimator_edges"
            )
        if ends in first:
            yield f"{where}: duplicate of communication.links[{first[ends]}], give each link once"
        first.setdefault(ends, index)
    delays = {f"links[{k}].delay_s": link.delay_s for k, link in enumerate(block.links)}
    for key, delay_s in {"delay_s": block.delay_s, **delays}.items():
        if delay_s is not None and delay_s >= block.stale_s:
            yield (
                f"communication.{key}: {delay_s:g}: expected less than communication.stale_s "
                f"({block.stale_s:g}), or the receiver holds for ever"
            )


def _parents(file: ScenarioFile) -> Problems:
    links, formation = file.communication, file.formation
    if not links.parents:
        return
    for child, weights in links.parents.items():
        where = f"communication.parents.{child}"
        above = links.tree.get(child)
        if above is None or above not in weights:
            known = "no follower" if above is None else f"expected {above}, its parent in the tree"
            yield f"{where}: {known}, among its parents"
        for parent in weights:
            if parent not in links.tree and parent != file.leader.id:
                yield f"{where}.{parent}: no such UAV; expected ids under uavs"
        total = math.fsum(weights.values())
        if abs(total - 1.0) > _WEIGHTS_SUM:
            yield f"{where}: weights sum to {total:g}: expected 1"
    edges = {child: {above} for child, above in links.tree.items()}
    try:
        TopologicalSorter({**edges, **links.parents}).prepare()
    except CycleError as error:
        cycle = " -> ".join(map(str, reversed(error.args[1])))
        yield f"communication.parents: cycle {cycle}: expected parents on the leader's side"
    expected = (
        (formation.task == "relative_position", "formation.task: relative_position"),
        (formation.vacancy == "wait", "formation.vacancy: wait"),
        (formation.assignment == "fixed", "formation.assignment: fixed"),
        (
            not (shapes.moves(formation) or legs.moves_shape(file.mission)),
            "a shape that does not move",
        ),
        (formation.sight_m == 0.0, "formation.sight_m: 0"),
        (not (file.law or file.plugins.task), "no law and no task of the user"),
    )
    for holds, what in expected:
        if not holds:
            yield f"communication.parents: expected {what}"


def estimator_peak(file: ScenarioFile) -> float:
    """Largest gain [1/s] of the estimator's time base, 0 without one."""
    gains = file.gains.estimator
    return peak_gain(gains.deadline_s, gains.residual) if gains.time_base else 0.0


def estimator_step(file: ScenarioFile, topology: Topology) -> float:
    """Step times fastest rate of the estimator, stable below STABILITY_LIMIT.

    dt (peak gain / lambda_min + k1 + k2 / boundary) lambda_max, see docs/method.md.
    """
    gains = file.gains.estimator
    peak = estimator_peak(file) / topology.lambda_min
    rate = peak + gains.k1_1_s + gains.k2 / gains.boundary
    return float(rate * topology.lambda_max / file.timing.control_hz)


def graph(file: ScenarioFile, source: str) -> Topology:
    """The communication graph of a file without `problems`.

    Raises:
        TopologyError: the graph cannot carry the formation.
        GainError: the estimator is not stable on this graph.
    """
    links = file.communication
    try:
        topology = validated_topology(
            file.leader.id,
            [uav.id for uav in file.uavs],
            links.tree,
            links.leader_links,
            links.estimator_edges,
        )
    except TopologyError as error:
        raise TopologyError(f"{source}: {error}") from None  # it names its own keys
    step = estimator_step(file, topology) if len(file.uavs) > 1 else 0.0
    if step >= STABILITY_LIMIT:
        raise GainError(
            f"{source}: gains.estimator: dt (Xi/lambda_min + k1 + k2/boundary) lambda_max = "
            f"{step:.3g}: expected < {STABILITY_LIMIT:g}; raise gains.estimator.boundary or "
            "deadline_s, give more leader_links, or raise timing.control_hz"
        )
    return topology
