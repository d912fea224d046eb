"""The parts that a scenario leaves to us: offsets of named shapes, first places of a take-off, and a tree for them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ptnsbc_core.tasks.formation_tasks import conditioning, metres_per_row, needs_arm
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.fields import replaced
from ptnsbc_sim.scenario.mission.legs import FormLeg, Places, TakeOffLeg
from ptnsbc_sim.scenario.mission.shapes import (
    Reshaping,
    ShapeBlock,
    changed,
    named_places,
    nearest_places,
)
from ptnsbc_sim.scenario.mission.trajectories import Hover
from ptnsbc_sim.scenario.model import AutoTree, ScenarioFile
from ptnsbc_sim.scenario.problems import ScenarioError, Tree

_DEEPEST = 3  # hops of a proposed tree
_POWERS = (3.0, 2.0, 1.5, 1.25, 1.0)  # of an edge's length: the first whose tree is not too deep
_CONDITIONED = 0.35  # smallest singular value of a task below which it is damped
SHORTEST_ARM_M = 1e-3
_OF_FORM = {"shape": "shape", "offsets_m": "offsets_m", "slots": "assignment"}


def with_first_leg(tree: Tree) -> Tree:
    """`tree` with what the leg of kind form says in the keys that say it without a mission; malformed as it is."""
    try:
        first, *rest = tree["mission"]["legs"]
        form = rest[0] if first["kind"] == "take_off" else first
        formation, gains, leader = tree["formation"], tree["gains"], tree["leader"]
        if form["kind"] != "form":
            return tree
        places = {name: form[key] for key, name in _OF_FORM.items() if form.get(key) is not None}
        if "shape" in places or "offsets_m" in places:
            formation = {k: v for k, v in formation.items() if k not in ("shape", "offsets_m")}
        formation = {**formation, **places}
        if form.get("over_s") is not None:
            gains = {**gains, "formation": {**gains["formation"], "deadline_s": form["over_s"]}}
        if form.get("trajectory") is not None:
            leader = {**leader, "trajectory": form["trajectory"]}
    except (LookupError, TypeError, ValueError, AttributeError):
        return tree
    return {**tree, "formation": formation, "gains": gains, "leader": leader}


def resolved(file: ScenarioFile, source: str) -> ScenarioFile:
    """`file` with offsets where it names shapes, with places for a take-off, and with a tree where it says `auto`.

    A file whose ids or offsets do not fit together stays as it is: `checked` names what is wrong.

    Raises:
        ScenarioError: both a shape and offsets are given, or no tree fits the shape.
    """
    ids, formation = file.followers, file.formation
    if len(set(file.uav_ids)) < len(file.uavs) or len(ids) == len(file.uavs):
        return file
    places: Places = formation.offsets_m
    if formation.shape is not None:
        places = _places_of(formation.shape, places, ids, f"{source}: formation")
        file = replaced(file, {"formation.offsets_m": places})
    if set(places) != set(ids):
        return file
    legs = () if file.mission is None else file.mission.legs
    if len(legs) > 1 and isinstance(legs[0], TakeOffLeg) and isinstance(legs[1], FormLeg):
        file, places = _risen(file, legs[0], legs[1], places, source)
        legs = file.mission.legs if file.mission else ()
    changes = _with_places(formation.changes, places, ids, f"{source}: formation.changes")
    file = replaced(file, {"formation.changes": changes})
    if legs:
        legs = _with_places(legs, places, ids, f"{source}: mission.legs")
        file = replaced(file, {"mission.legs": legs})
    if isinstance(file.communication.tree, AutoTree):
        leader, anchor = file.leader.id, np.array(formation.heading_anchor_m)
        at = {leader: np.zeros(3), **{uav: np.array(place) for uav, place in places.items()}}
        parents = proposed_tree(at, leader, formation.task, anchor)
        if missing := sorted(set(ids) - set(parents)):
            raise ScenarioError(
                f"{source}: communication.tree: auto: no well conditioned parent for UAV {missing[0]}: expected "
                "another shape, formation.task: relative_position, or the tree itself"
            )
        file = replaced(file, {"communication.tree": parents})
    return file


def _risen(
    file: ScenarioFile, first: TakeOffLeg, form: FormLeg, places: Places, source: str
) -> tuple[ScenarioFile, Places]:
    """`file` with the starts as the first places and the formation in the leg `form`, and the places of that leg.

    The first epoch finds every UAV in its place: beside the leader as it starts, around a hovering leader. `take_off`
    moves leader and places, `form` is a change of the shape and a leg of the leader in one.
    """
    deadline_s = file.gains.formation.deadline_s
    if math.isinf(deadline_s):
        raise ScenarioError(f"{source}: mission.legs[1].over_s: missing: expected a number in s")
    starts = {uav.id: np.array(uav.position_m, dtype=np.float64) for uav in file.uavs}
    if first.from_m is not None:
        starts = {uav: np.array([*at[:2], first.from_m]) for uav, at in starts.items()}
    here = starts[file.leader.id]
    offsets = {uav: starts[uav] - here for uav in file.followers}
    if file.formation.assignment == "optimal" and offsets:
        then = np.array([places[uav] for uav in offsets])
        order = nearest_places(np.array(list(offsets.values())), then)
        places = _by_uav(file.followers, then[order])
    changes = {
        "shape": None,
        "over_s": deadline_s,
        "offsets_m": places,
        "trajectory": file.leader.trajectory,
    }
    hover = Hover.model_validate({"kind": "hover", "position_m": here.tolist()})
    legs = file.mission.legs if file.mission else ()
    keys = {
        "formation.shape": None,
        "formation.offsets_m": _by_uav(offsets, offsets.values()),
        "formation.assignment": "fixed",
        "gains.formation.deadline_s": first.over_s,
        "leader.trajectory": hover,
        "mission.legs": (first, form.model_copy(update=changes), *legs[2:]),
    }
    return replaced(file, keys), places


def _by_uav(ids: Any, places: Any) -> Places:
    """Places (N, 3) by UAV, as a file holds them."""
    return {uav: tuple(place.tolist()) for uav, place in zip(ids, places, strict=True)}


def _places_of(shape: ShapeBlock, offsets_m: Any, ids: Sequence[int], where: str) -> Places:
    """Places of the followers in a named shape."""
    if offsets_m:
        raise ScenarioError(f"{where}.shape: expected either shape or offsets_m, not both")
    try:
        return _by_uav(ids, named_places(shape, len(ids) + 1)[1:])
    except ValueError as error:
        raise ScenarioError(f"{where}.shape.{error}") from None


def _with_places(
    legs: Sequence[Any], present: Places, ids: Sequence[int], where: str
) -> tuple[Any, ...]:
    """Changes or legs, those to named shapes with the places that the followers take.

    They take the places with the least squared distances from those before.
    """
    now = held = np.array([present[uav] for uav in ids]).reshape(-1, 3)
    filled = []
    for index, leg in enumerate(legs):
        if isinstance(leg, Reshaping):
            if leg.shape is not None:
                places = _places_of(leg.shape, leg.offsets_m, ids, f"{where}[{index}]")
                held = np.array([places[uav] for uav in ids]).reshape(-1, 3)
                held = held[nearest_places(now, changed(leg, held))]
                leg = leg.model_copy(update={"offsets_m": _by_uav(ids, held)})
            elif leg.offsets_m is not None:
                if set(leg.offsets_m) != set(ids):
                    return tuple(legs)
                held = np.array([leg.offsets_m[uav] for uav in ids]).reshape(-1, 3)
            now = changed(leg, held)
        filled.append(leg)
    return tuple(filled)


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
    parents: dict[int, int] = {}
    for power in _POWERS:
        costs = lengths**power
        costs[~np.isfinite(costs)] = 0.0  # no edge
        _, rows = dijkstra(costs, indices=ids.index(leader), return_predecessors=True)
        parents = {uav: ids[row] for uav, row in zip(ids, rows.tolist(), strict=True) if row >= 0}
        if all(_hops(parents, uav) <= _DEEPEST for uav in parents):
            break
    return parents


def _hops(parents: Mapping[int, int], uav: int) -> int:
    return 1 + _hops(parents, parents[uav]) if uav in parents else 0


def _usable(task: str, own: Array, above: Array, reference: Array) -> bool:
    """True if a follower can hold its place by this task with that parent."""
    arm = float(np.hypot(*(own - above)[:2]))
    if not needs_arm(task):
        return True
    if arm < SHORTEST_ARM_M:
        return False
    scale = metres_per_row(task, arm)
    return conditioning(TASKS[task], own, above, reference, scale) >= _CONDITIONED
