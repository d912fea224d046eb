"""The parts that a scenario leaves to us: the offsets of a named shape, and a tree for it.

Both are worked out on the tree of the file, before the schema reads it. The schema names what is malformed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ptnsbc_core.errors import FormationError
from ptnsbc_core.tasks.formation_tasks import conditioning, metres_per_row, needs_arm
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.fields import Number, Vec3
from ptnsbc_sim.scenario.mission.legs import ChangeLeg
from ptnsbc_sim.scenario.mission.shapes import (
    Change,
    Reshaping,
    ShapeBlock,
    changed,
    named_places,
    nearest_places,
)
from ptnsbc_sim.scenario.problems import ScenarioError

AUTO_TREE = "auto"
_DEEPEST = 3  # hops of a proposed tree
_POWERS = (
    3.0,
    2.0,
    1.5,
    1.25,
    1.0,
)  # of an edge's length: the first one whose tree is not too deep
_CONDITIONED = 0.35  # smallest singular value of a task below which it is damped

Tree = dict[Any, Any]

_NUMBER, _PLACE, _PLACES = TypeAdapter(Number), TypeAdapter(Vec3), TypeAdapter(dict[int, Vec3])


def completed_mission(tree: Tree, source: str) -> Tree:
    """`tree` with what the first legs of its mission say of the formation in the keys that say it without a mission.

    Raises:
        ScenarioError: a leg gives both a shape and offsets.
    """
    legs = _legs(tree)
    first = legs[0] if legs else None
    if not isinstance(first, dict):
        return tree
    if first.get("kind") == "take_off":
        return _risen(_with_form(tree, legs[1]), source) if len(legs) > 1 else tree
    return _with_form(tree, first)


def _legs(tree: Tree) -> list[Any]:
    """The legs of the mission; none where it is malformed."""
    mission = tree.get("mission")
    legs = mission.get("legs") if isinstance(mission, dict) else None
    return legs if isinstance(legs, list) else []


def _with_form(tree: Tree, form: Any) -> Tree:
    """`tree` with what a leg of kind form says in the keys that say it without a mission."""
    formation, gains, leader = (tree.get(key) for key in ("formation", "gains", "leader"))
    if not isinstance(form, dict) or form.get("kind") != "form":
        return tree
    if form.get("over_s") is not None and isinstance(gains, dict):
        loop = gains.get("formation")
        if isinstance(loop, dict):
            loop = {**loop, "deadline_s": form["over_s"]}
            tree = {**tree, "gains": {**gains, "formation": loop}}
    if form.get("trajectory") is not None and isinstance(leader, dict):
        tree = {**tree, "leader": {**leader, "trajectory": form["trajectory"]}}
    if isinstance(formation, dict):
        places = {key: form[key] for key in ("shape", "offsets_m") if form.get(key) is not None}
        if places:
            rest = {
                key: value for key, value in formation.items() if key not in ("shape", "offsets_m")
            }
            formation = {**rest, **places}
        if form.get("slots") is not None:
            formation = {**formation, "assignment": form["slots"]}
        tree = {**tree, "formation": formation}
    return tree


def _risen(tree: Tree, source: str) -> Tree:
    """`tree` with the starts as the first places, and with the formation in the leg `form` after the take-off.

    The first epoch finds every UAV in its place: beside the leader as it starts, around a hovering leader. `take_off`
    moves leader and places, `form` is a change of the shape and a leg of the leader in one.
    """
    formation, gains, leader = (tree.get(key) for key in ("formation", "gains", "leader"))
    ids, (first, form, *rest) = _followers(tree), _legs(tree)
    starts = _starts(tree, first.get("from_m"))
    loop = gains.get("formation") if isinstance(gains, dict) else None
    if not (isinstance(formation, dict) and isinstance(leader, dict) and isinstance(gains, dict)):
        return tree
    if ids is None or starts is None or not isinstance(loop, dict):
        return tree
    if not isinstance(form, dict) or form.get("kind") != "form":
        return tree
    path, own = leader.get("trajectory"), starts[leader["id"]]
    offsets = {uav: (starts[uav] - own).tolist() for uav in ids}
    formed = _with_offsets(formation, ids, "formation", source)
    places = _offsets(formed)
    if places is None or set(places) != set(ids):
        return tree
    if formation.get("assignment") == "optimal" and ids:
        now, then = (np.array([of[uav] for uav in ids]) for of in (offsets, places))
        order = nearest_places(now, then)
        places = {uav: then[row] for uav, row in zip(ids, order, strict=True)}
    form = {
        **{key: value for key, value in form.items() if key != "shape"},
        "over_s": loop.get("deadline_s"),
        "offsets_m": {uav: place.tolist() for uav, place in places.items()},
        "trajectory": path,
    }
    formation = {key: value for key, value in formation.items() if key != "shape"}
    return {
        **tree,
        "formation": {**formation, "offsets_m": offsets, "assignment": "fixed"},
        "gains": {**gains, "formation": {**loop, "deadline_s": first.get("over_s")}},
        "leader": {**leader, "trajectory": {"kind": "hover", "position_m": own.tolist()}},
        "mission": {**tree["mission"], "legs": [first, form, *rest]},
    }


def _starts(tree: Tree, from_m: Any) -> dict[int, Array] | None:
    """The start (3,) [m] of every UAV, at the height `from_m` where it is given; None where the file is malformed."""
    try:
        height = None if from_m is None else _NUMBER.validate_python(from_m)
        found = {
            uav["id"]: np.array(_PLACE.validate_python(uav.get("position_m")))
            for uav in tree.get("uavs", ())
        }
    except (ValidationError, TypeError, KeyError, AttributeError):
        return None
    leader = tree.get("leader")
    if not isinstance(leader, dict) or leader.get("id") not in found:
        return None
    if height is not None:
        found = {uav: np.array([*place[:2], height]) for uav, place in found.items()}
    return found


def _formed(tree: Tree) -> Tree:
    """The block with the places of the formation: that of the leg `form` after a take-off."""
    legs, formation = _legs(tree), tree["formation"]
    rises = len(legs) > 1 and isinstance(legs[0], dict) and legs[0].get("kind") == "take_off"
    if rises and isinstance(legs[1], dict) and legs[1].get("offsets_m") is not None:
        return {**formation, "offsets_m": legs[1]["offsets_m"]}
    return dict(formation)


def completed_shape(tree: Tree, source: str) -> Tree:
    """`tree` with offsets where it names shapes, and with a communication tree where it says `auto`.

    Raises:
        ScenarioError: both a shape and offsets are given, or no tree fits the shape.
    """
    formation = tree.get("formation")
    ids = _followers(tree)
    if not isinstance(formation, dict) or ids is None:
        if isinstance(formation, dict) and formation.get("shape") is not None:
            tree = {**tree, "formation": {"offsets_m": {}, **formation}}
        return _without_auto(tree)
    formation = _with_offsets(formation, ids, "formation", source)
    formation = _with_changes(formation, ids, source)
    if formation is not tree["formation"]:
        tree = {**tree, "formation": formation}
    tree = _with_leg_places(tree, ids, source)
    return _with_tree(tree, ids, source)


def _followers(tree: Tree) -> list[int] | None:
    """The ids of the followers in the order of the file; None where it is malformed."""
    uavs, leader = tree.get("uavs"), tree.get("leader")
    if not isinstance(uavs, list) or not isinstance(leader, dict):
        return None
    ids: list[Any] = [uav.get("id") if isinstance(uav, dict) else None for uav in uavs]
    if not all(type(uav) is int for uav in ids) or len(set(ids)) != len(ids):
        return None
    return [uav for uav in ids if uav != leader.get("id")]


def _shape(block: Tree) -> ShapeBlock | None:
    try:
        return ShapeBlock.model_validate(block.get("shape"))
    except ValidationError:
        return None


def _offsets(block: Tree) -> dict[int, Array] | None:
    try:
        found = _PLACES.validate_python(block.get("offsets_m"))
    except ValidationError:
        return None
    return {uav: np.array(place) for uav, place in found.items()}


def _with_offsets(block: Tree, ids: list[int], where: str, source: str) -> Tree:
    if block.get("shape") is None:
        return block
    if block.get("offsets_m") is not None:
        raise ScenarioError(
            f"{source}: {where}.shape: expected either shape or offsets_m, not both"
        )
    shape = _shape(block)
    if shape is None:
        return {**block, "offsets_m": {}}
    try:
        places = named_places(shape, len(ids) + 1)[1:]
    except ValueError as error:
        raise ScenarioError(f"{source}: {where}.shape.{error}") from None
    return {**block, "offsets_m": dict(zip(ids, places.tolist(), strict=True))}


def _with_changes(formation: Tree, ids: list[int], source: str) -> Tree:
    """`formation` with the places of each change to a named shape."""
    changes, present = formation.get("changes"), _offsets(formation)
    if not isinstance(changes, list) or present is None:
        return formation
    named = {f"formation.changes[{index}]": block for index, block in enumerate(changes)}
    filled = _filled(named, Change, present, ids, source)
    return formation if filled is None else {**formation, "changes": list(filled.values())}


def _with_leg_places(tree: Tree, ids: list[int], source: str) -> Tree:
    """`tree` with the places of each leg that changes to a named shape."""
    legs, present = _legs(tree), _offsets(_formed(tree))
    if not legs or present is None:
        return tree
    where = {
        f"mission.legs[{index}]": leg
        for index, leg in enumerate(legs)
        if isinstance(leg, dict) and leg.get("kind") == "change"
    }
    filled = _filled(where, ChangeLeg, present, ids, source)
    if filled is None:
        return tree
    legs = [filled.get(f"mission.legs[{index}]", leg) for index, leg in enumerate(legs)]
    return {**tree, "mission": {**tree["mission"], "legs": legs}}


def _filled(
    changes: Mapping[str, Any],
    kind: type[Reshaping],
    present: Mapping[int, Array],
    ids: list[int],
    source: str,
) -> dict[str, Tree] | None:
    """Changes by their keys, those to named shapes with the places that the followers take; None: one is malformed.

    They take the places with the least squared distances from those before.
    """
    if set(present) != set(ids):
        return None
    now = np.stack([present[uav] for uav in ids]) if ids else np.zeros((0, 3))
    held, filled = now, {}
    for where, block in changes.items():
        if not isinstance(block, dict):
            return None
        whole = _with_offsets(block, ids, where, source)
        try:
            change = kind.model_validate(whole)
        except ValidationError:
            return None
        if change.offsets_m is not None:
            if set(change.offsets_m) != set(ids):
                return None
            held = np.array([change.offsets_m[uav] for uav in ids])
        if change.shape is not None:
            held = held[nearest_places(now, changed(change, held))]
            whole = {**whole, "offsets_m": dict(zip(ids, held.tolist(), strict=True))}
        now = changed(change, held)
        filled[where] = whole
    return filled


def _without_auto(tree: Tree) -> Tree:
    """`tree` with no communication tree instead of `auto`: something else is malformed, and that is to be named."""
    links = tree.get("communication")
    if not isinstance(links, dict) or links.get("tree") != AUTO_TREE:
        return tree
    return {**tree, "communication": {**links, "tree": {}}}


def _with_tree(tree: Tree, ids: list[int], source: str) -> Tree:
    links, formation = tree.get("communication"), _formed(tree)
    if not isinstance(links, dict) or links.get("tree") != AUTO_TREE:
        return tree
    offsets, leader = _offsets(formation), tree["leader"].get("id")
    task, anchor = formation.get("task"), formation.get("heading_anchor_m", [2.0, 0.0, 0.0])
    whole = offsets is not None and set(offsets) == set(ids) and len(ids) < len(tree["uavs"])
    try:
        anchor = _PLACE.validate_python(anchor)
    except ValidationError:
        return _without_auto(tree)
    if offsets is None or not whole or not isinstance(task, str) or task not in TASKS:
        return _without_auto(tree)
    places = {leader: np.zeros(3), **offsets}
    parents = proposed_tree(places, leader, task, np.array(anchor))
    missing = sorted(set(ids) - set(parents))
    if missing:
        raise ScenarioError(
            f"{source}: communication.tree: auto: no well conditioned parent for UAV {missing[0]}: expected "
            "another shape, formation.task: relative_position, or the tree itself"
        )
    return {**tree, "communication": {**links, "tree": parents}}


def proposed_tree(
    places: Mapping[int, Array], leader: int, task: str, anchor: Array
) -> dict[int, int]:
    """Parent of every follower that one can be found for.

    The tree is that of shortest paths from the leader, over edges that cost a power of their length. A high power
    prefers short edges, and 1 hangs every follower directly on the leader. The highest power with a depth of three at
    most is taken. Edges over which the task is badly conditioned are left out.

    Args:
        places: (3,) [m] of every UAV, relative to the leader.
        leader: its id.
        task: name of the formation task.
        anchor: (3,) [m], the reference of the leader's children.
    """
    from scipy.sparse.csgraph import dijkstra  # late: half a second

    ids = sorted(places)
    lengths = np.full((len(ids), len(ids)), np.inf)
    for row, above in enumerate(ids):
        reference = anchor if above == leader else np.zeros(3)
        for column, uav in enumerate(ids):
            if uav not in (leader, above) and _usable(task, places[uav], places[above], reference):
                lengths[row, column] = np.linalg.norm(places[uav] - places[above])
    root, found = ids.index(leader), np.zeros(0)
    for power in _POWERS:
        costs = lengths**power
        costs[~np.isfinite(costs)] = 0.0  # no edge
        _, found = dijkstra(costs, indices=root, return_predecessors=True)
        if _depth(found, root) <= _DEEPEST:
            break
    return {uav: ids[int(above)] for uav, above in zip(ids, found, strict=True) if above >= 0}


def _depth(parents: Array, root: int) -> int:
    deepest = 0
    for node in range(len(parents)):
        hops, at = 0, node
        while at != root and parents[at] >= 0:
            hops, at = hops + 1, int(parents[at])
        deepest = max(deepest, hops)
    return deepest


def _usable(task: str, own: Array, above: Array, reference: Array) -> bool:
    """True if a follower can hold its place by this task with that parent."""
    arm = float(np.hypot(*(own - above)[:2]))
    if not needs_arm(task):
        return True
    if arm < 1e-3:
        return False
    scale = metres_per_row(task, arm)
    try:
        return conditioning(TASKS[task], own, above, reference, scale) >= _CONDITIONED
    except FormationError:
        return False
