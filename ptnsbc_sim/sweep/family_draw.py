"""Draws of a family: a scenario from its distributions, each quantity from random numbers of its own."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np

from ptnsbc_core.timebase import feasible_deadline
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.gains import Filter
from ptnsbc_sim.scenario.mission.shapes import SHAPES
from ptnsbc_sim.scenario.model import ScenarioFile
from ptnsbc_sim.scenario.problems import Tree
from ptnsbc_sim.sweep.draws import Spheres, clear_places, spheres_of
from ptnsbc_sim.sweep.family import (
    Family,
    FamilyDeadline,
    FamilyMass,
    FamilyObstacles,
    FamilyPath,
    FamilyStarts,
)

Generator = Callable[[str], np.random.Generator]
_MOST_TRIES = 200
_ASIDE_M = 3.0  # obstacles lie so far around starts and goals at most
_HEIGHT_M = 5.0


def _number(given: float | tuple[float, float], rng: np.random.Generator) -> float:
    if isinstance(given, tuple):
        return float(rng.uniform(*given))
    return float(given)


def _count(given: int | tuple[int, int], rng: np.random.Generator) -> int:
    if isinstance(given, tuple):
        return int(rng.integers(given[0], given[1] + 1))
    return given


def _one_of(kinds: tuple[str, ...], rng: np.random.Generator) -> str:
    return kinds[int(rng.integers(len(kinds)))]


def _parents(kind: str, size: int, depth: int, rng: np.random.Generator) -> dict[int, int]:
    """Parent of every follower; UAV 1 leads."""
    if kind == "chain":
        return {uav: uav - 1 for uav in range(2, size + 1)}
    if kind == "star":
        return dict.fromkeys(range(2, size + 1), 1)
    hops, parents = {1: 0}, {}
    for uav in range(2, size + 1):
        open_to = [other for other, far in hops.items() if far < depth]
        parents[uav] = open_to[int(rng.integers(len(open_to)))]
        hops[uav] = hops[parents[uav]] + 1
    return parents


def _random_places(size: int, spacing: float, rng: np.random.Generator) -> Array:
    half = 1.5 * spacing * math.sqrt(size) * np.array([1.0, 1.0, 0.25])
    return np.concatenate([np.zeros((1, 3)), _spread(size - 1, half, spacing, rng)])


def _spread(count: int, half: Array, apart: float, rng: np.random.Generator) -> Array:
    """Places (count, 3) in a box around the leader, apart from it and from each other."""
    found = [np.zeros(3)]
    while len(found) <= count:
        place = half * rng.uniform(-1.0, 1.0, 3)
        level = [math.hypot(*(place - other)[:2]) for other in found]
        if min(level) >= apart:
            found.append(place)
    return np.array(found[1:]).reshape(-1, 3)


def _places(kind: str, size: int, spacing: float, rng: np.random.Generator) -> Array:
    """Places (N, 3) [m] relative to the leader, which is the first."""
    if kind == "random":
        return _random_places(size, spacing, rng)
    return SHAPES[kind](size, spacing)


def _path(path: FamilyPath, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    """The leader's trajectory, and what was drawn for it."""
    kind = _one_of(path.kinds, rng)
    speed, radius = _number(path.speed_m_s, rng), _number(path.radius_m, rng)
    angle = float(rng.uniform(-math.pi, math.pi))
    drawn = {"path": kind, "speed_m_s": 0.0, "radius_m": None}
    if kind == "hover":
        return {"kind": "line", "position_m": [0.0, 0.0, _HEIGHT_M]}, drawn
    drawn["speed_m_s"] = speed
    if kind == "line":
        velocity = [speed * math.cos(angle), speed * math.sin(angle), 0.0]
        line = {"kind": "line", "position_m": [0.0, 0.0, _HEIGHT_M], "velocity_m_s": velocity}
        return line, drawn
    drawn["radius_m"] = radius
    centre = [0.0, -radius, _HEIGHT_M]  # begins above the origin
    circle = {
        "kind": "circle",
        "centre_m": centre,
        "radius_m": radius,
        "rate_rad_s": speed / radius,
    }
    return circle, drawn


def _starts(
    starts: FamilyStarts, goals: Array, spheres: Spheres, rng: np.random.Generator
) -> list[Array]:
    sigma = np.full(3, _number(starts.sigma_m, rng))
    if starts.kind == "box":
        half = 0.5 * np.array(starts.box_m)
        centre = goals.mean(axis=0)
        centre[2] = goals[:, 2].min() + half[2]
        return clear_places([(centre, half)] * len(goals), False, spheres, rng)
    places = goals
    if starts.kind == "swap":  # a cycle: nobody keeps its place
        cycle = 1 + rng.permutation(len(goals) - 1)
        places = goals.copy()
        places[cycle] = goals[np.roll(cycle, 1)]
    if starts.kind == "opposite":
        places = 2.0 * goals[0] - goals
    return clear_places([(place, sigma) for place in places], True, spheres, rng)


def _obstacles(
    block: FamilyObstacles,
    starts: Array,
    goals: Array,
    margin_m: float,
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """As many as there is room for: none holds a start or a place, none meets another one."""
    found: list[dict[str, Any]] = []
    ends = np.concatenate([starts, goals])
    low, high = ends.min(axis=0) - _ASIDE_M, ends.max(axis=0) + _ASIDE_M
    for _ in range(_count(block.count, rng)):
        radius = _number(block.keep_out_m, rng)
        for _ in range(_MOST_TRIES):
            if block.where == "way":
                which, share = int(rng.integers(len(starts))), rng.uniform(0.25, 0.75)
                place = starts[which] + share * (goals[which] - starts[which])
                place = place + 0.5 * radius * rng.standard_normal(3)
            else:
                place = rng.uniform(low, high)
            free = np.linalg.norm(ends - place, axis=1).min() > radius + margin_m
            if free and all(
                np.linalg.norm(place - np.array(one["position_m"])) > radius + one["keep_out_m"]
                for one in found
            ):
                name = f"O{len(found) + 1}"
                found.append({"name": name, "position_m": place.tolist(), "keep_out_m": radius})
                break
    return found


def _deadline_s(
    block: FamilyDeadline,
    starts: Array,
    goals: Array,
    limits: Filter,
    rng: np.random.Generator,
) -> float:
    if block.seconds is not None:
        return _number(block.seconds, rng)
    assert block.of_feasible is not None
    own = starts - starts[0] - (goals - goals[0])
    errors = [float(np.linalg.norm(starts[0] - goals[0])), *np.linalg.norm(own, axis=1).tolist()]
    shortest = feasible_deadline(max(errors), limits.max_speed_m_s, limits.max_acceleration_m_s2)
    return max(_number(block.of_feasible, rng) * shortest, block.at_least_s)


def _uavs(base: list[dict[str, Any]], starts: list[Array]) -> list[dict[str, Any]]:
    """Starts with the attitudes and disturbances of the base scenario's UAVs, over and over."""
    return [
        {**deepcopy(base[row % len(base)]), "id": row + 1, "position_m": place.tolist()}
        for row, place in enumerate(starts)
    ]


def _network(parents: dict[int, int], size: int) -> dict[str, Any]:
    followers = list(range(2, size + 1))
    edges = [[uav, uav + 1] for uav in followers[:-1]]
    return {"tree": parents, "leader_links": followers, "estimator_edges": edges, "links": []}


def draw_family(
    family: Family, base: ScenarioFile, tree: Tree, generator: Generator
) -> dict[str, Any]:
    """Draw a scenario of the family into the text of the base scenario.

    Args:
        family: what to draw from.
        base: the base scenario.
        tree: the keys of its text, which are changed in place.
        generator: the random numbers of one quantity by its name: none depends on what else is drawn.

    Returns:
        What was drawn, by column of the table.
    """
    size = _count(family.size, generator("family size"))
    rng = generator("family tree")
    tree_kind = _one_of(family.tree.kinds, rng)
    parents = _parents(tree_kind, size, family.tree.depth, rng)
    rng = generator("family shape")
    shape, spacing = _one_of(family.shape.kinds, rng), _number(family.shape.spacing_m, rng)
    offsets = _places(shape, size, spacing, rng)
    trajectory, values = _path(family.path, generator("family path"))
    goals = np.array([0.0, 0.0, _HEIGHT_M]) + offsets
    margin_m = float(base.gains.clearance.margin_m)
    world = dict(tree.get("world") or {})
    world["obstacles"] = []
    tree["world"] = world
    spheres = spheres_of(base, ())
    apart = replace(spheres, apart_m=max(spheres.apart_m, family.starts.apart_m))
    starts = _starts(family.starts, goals, apart, generator("family starts"))
    places = np.array(starts)
    if family.obstacles is not None:
        room = margin_m + spheres.apart_m
        rng = generator("family obstacles")
        world["obstacles"] = _obstacles(family.obstacles, places, goals, room, rng)
    tree["uavs"] = _uavs(tree["uavs"], starts)
    tree["communication"] = {**tree["communication"], **_network(parents, size)}
    tree["leader"] = {"id": 1, "trajectory": trajectory}
    followers = {uav + 1: offsets[uav].tolist() for uav in range(1, size)}
    tree["formation"] = {**tree["formation"], "offsets_m": followers}
    tree["formation"].pop("shape", None)
    for key, value in (("task", family.task), ("assignment", family.assignment)):
        if value is not None:
            tree["formation"][key] = value
    values |= {
        "size": size,
        "tree": tree_kind,
        "shape": shape,
        "spacing_m": spacing,
        "obstacles": len(world["obstacles"]),
    }
    values |= _draw_deadline(family, base, tree, places, goals, generator("family deadline"))
    values |= _draw_surroundings(family, tree, generator)
    return values


def _draw_deadline(
    family: Family,
    base: ScenarioFile,
    tree: Tree,
    starts: Array,
    goals: Array,
    rng: np.random.Generator,
) -> dict[str, Any]:
    if family.deadline is None:
        return {}
    deadline_s = _deadline_s(family.deadline, starts, goals, base.gains.filter, rng)
    formation = {**tree["gains"].get("formation", {}), "deadline_s": deadline_s}
    tree["gains"] = {**tree["gains"], "formation": formation}
    tree["timing"] = {**tree["timing"], "duration_s": deadline_s + family.deadline.after_s}
    return {"deadline_s": deadline_s}


def _draw_surroundings(family: Family, tree: Tree, generator: Generator) -> dict[str, Any]:
    values: dict[str, Any] = {}
    if family.wind is not None:
        rng = generator("family wind")
        speed, gust = _number(family.wind.mean_m_s, rng), _number(family.wind.gust_m_s, rng)
        angle = float(rng.uniform(-math.pi, math.pi))
        tree["world"]["wind_m_s"] = [speed * math.cos(angle), speed * math.sin(angle), 0.0]
        tree["world"]["gust_m_s"] = [gust, gust, gust]
        values |= {"wind_m_s": speed, "gust_m_s": gust}
    if family.delay_s is not None:
        delay_s = _number(family.delay_s, generator("family delay"))
        tree["communication"]["delay_s"] = delay_s
        values["delay_s"] = delay_s
    if family.mass is not None:
        values["heaviest"], values["lightest"] = _draw_masses(
            family.mass, tree, generator("family mass")
        )
    return values


def _draw_masses(mass: FamilyMass, tree: Tree, rng: np.random.Generator) -> tuple[float, float]:
    """Draw true mass and inertia of every UAV; returns the largest and the smallest factor of the mass."""
    for uav in tree["uavs"]:
        uav["mass_scale"] = _number(mass.mass_scale, rng)
        uav["inertia_scale"] = [_number(mass.inertia_scale, rng) for _ in range(3)]
    scales = [uav["mass_scale"] for uav in tree["uavs"]]
    return max(scales), min(scales)


def family_columns(family: Family) -> dict[str, str]:
    """Columns of what `draw_family` draws, and the kind of each."""
    columns = {
        "path": "str",
        "speed_m_s": "float",
        "radius_m": "float",
        "size": "int",
        "tree": "str",
        "shape": "str",
        "spacing_m": "float",
        "obstacles": "int",
    }
    if family.deadline is not None:
        columns["deadline_s"] = "float"
    if family.wind is not None:
        columns |= {"wind_m_s": "float", "gust_m_s": "float"}
    if family.delay_s is not None:
        columns["delay_s"] = "float"
    if family.mass is not None:
        columns |= {"heaviest": "float", "lightest": "float"}
    return columns
