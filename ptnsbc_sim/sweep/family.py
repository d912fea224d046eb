"""Families of scenarios: a small YAML file of distributions over size, tree, shape, starts, path and surroundings.

A family replaces the UAVs, the tree, the shape, the leader's path and, where it names them, the deadline, the
obstacles and the wind of the base scenario. Vehicle, sensors, gains and task stay the base scenario's.
`family.schema.json` beside this module is the JSON schema of a family, for editors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.tasks.table import TaskName
from ptnsbc_core.timebase import feasible_deadline
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.fields import Block, Count, Name, NotNegative, Positive
from ptnsbc_sim.scenario.mission.shapes import SHAPES
from ptnsbc_sim.scenario.mission.trajectories import Circle, Line, trajectory_of
from ptnsbc_sim.scenario.model import ScenarioFile
from ptnsbc_sim.scenario.problems import ScenarioError, Tree, scenario_error
from ptnsbc_sim.scenario.reading import reader
from ptnsbc_sim.sweep.draws import BOX, NEAR, Spacing, Starts, drawn_places, spacing_of


def _ascending(value: Any) -> Any:
    if isinstance(value, tuple) and value[0] > value[1]:
        raise PydanticCustomError(
            "range", "expected [low, high], which ascend", {"value": [*value]}
        )
    return value


_Ascending = AfterValidator(_ascending)
_FROM_TWO = Field(description="a number, or [low, high] to draw from")
Range = Annotated[NotNegative | tuple[NotNegative, NotNegative], _Ascending, _FROM_TWO]
"""A range is [low, high]; a number alone is that number in every draw."""
PositiveRange = Annotated[Positive | tuple[Positive, Positive], _Ascending, _FROM_TWO]
_Count = Annotated[Count, Field(le=254)]
CountRange = Annotated[
    _Count | tuple[_Count, _Count], _Ascending, Field(description="a number, or [low, high]")
]


class FamilyTree(Block):
    """The parent of every follower."""

    kinds: Annotated[tuple[Literal["chain", "star", "random"], ...], Field(min_length=1)] = (
        "random",
    )
    """One of these is drawn. Followers hear the leader, and the next and the last one by number."""
    depth: Count = 3
    """Most hops from the leader, of a random tree."""


class FamilyShape(Block):
    """The formation."""

    kinds: Annotated[
        tuple[Literal["v", "line", "column", "grid", "circle", "sphere", "random"], ...],
        Field(min_length=1),
    ] = ("v",)
    """One of these is drawn: those of `formation.shape`, or `random` places."""
    spacing_m: PositiveRange = 2.0
    """Between neighbours in the shape; of the random shape the least distance."""


class FamilyStarts(Block):
    """The starts of the UAVs."""

    kind: Literal["near", "box", "swap", "opposite"] = "near"
    """Beside their places, anywhere in a box, each follower at the place of another one, or across the leader."""
    sigma_m: Range = 0.5
    """Of `near`, `swap` and `opposite`: standard deviation per axis."""
    box_m: tuple[Positive, Positive, Positive] = (10.0, 10.0, 4.0)
    """Of `box`: its edges; the lowest places of the formation lie at its bottom."""
    apart_m: NotNegative = 0.0
    """Least distance between two starts, where it is more than formation.uav_keep_out_m and the margin."""


class FamilyPath(Block):
    """The path of the leader."""

    kinds: Annotated[tuple[Literal["hover", "line", "circle"], ...], Field(min_length=1)] = (
        "hover",
    )
    """One of these is drawn."""
    speed_m_s: Range = (0.2, 1.0)
    """Of a line, in any horizontal direction, and along a circle."""
    radius_m: PositiveRange = (3.0, 8.0)
    """Of a circle."""


class FamilyDeadline(Block):
    """The promise: one of the two."""

    seconds: PositiveRange | None = None
    """Absolute."""
    of_feasible: PositiveRange | None = None
    """Multiple of the shortest that the speed and acceleration limits allow for the largest start error."""
    at_least_s: NotNegative = 1.0
    """With `of_feasible`: never shorter."""
    after_s: Positive = 10.0
    """The flight ends so long after the deadline."""

    @model_validator(mode="after")
    def _one(self) -> FamilyDeadline:
        if (self.seconds is None) == (self.of_feasible is None):
            raise ValueError("expected one of seconds and of_feasible")
        return self


class FamilyObstacles(Block):
    """Spheres to keep out of."""

    count: CountRange
    """Number of obstacles, as far as there is room for them: the table tells how many there were. None holds a start,
    or a place from the deadline on: no UAV could be in it."""
    keep_out_m: PositiveRange = (0.5, 1.5)
    """Radius."""
    where: Literal["way", "anywhere"] = "way"
    """Between starts and places, or anywhere around both."""


class FamilyWind(Block):
    """Wind from any horizontal direction."""

    mean_m_s: Range = 0.0
    """Speed."""
    gust_m_s: Range = 0.0
    """Standard deviation of the gusts, per axis."""


class FamilyMass(Block):
    """True mass and inertia over what the laws know, drawn for each UAV, and for each axis of it."""

    mass_scale: PositiveRange = 1.0
    """Of the mass."""
    inertia_scale: PositiveRange = 1.0
    """Of the moments of inertia."""


class Family(Block):
    """A family of scenarios."""

    name: Name
    """Of the family."""
    description: str = ""
    """For people."""
    size: CountRange = 5
    """UAVs, the leader among them."""
    tree: FamilyTree = FamilyTree()
    """The parent of every follower."""
    shape: FamilyShape = FamilyShape()
    """The formation."""
    starts: FamilyStarts = FamilyStarts()
    """The starts of the UAVs."""
    path: FamilyPath = FamilyPath()
    """The path of the leader."""
    task: TaskName | None = None
    """formation.task; the base scenario's without it."""
    assignment: Literal["fixed", "optimal"] | None = None
    """formation.assignment; the base scenario's without it."""
    deadline: FamilyDeadline | None = None
    """The promise; the base scenario's without it."""
    obstacles: FamilyObstacles | None = None
    """Spheres to keep out of; none without it."""
    delay_s: Range | None = None
    """Delay of the messages between UAVs; the base scenario's without it."""
    wind: FamilyWind | None = None
    """The base scenario's wind without it."""
    mass: FamilyMass | None = None
    """True mass and inertia; those of the base scenario's UAVs without it."""


def families() -> list[str]:
    """The names of the families that can be given without a path."""
    return reader.available("families")


def find_family(name: str | Path) -> Path:
    """The file of a family, given by path or by name."""
    given = Path(name).expanduser()
    places = [given]
    if len(given.parts) == 1 and not given.suffix:
        places = [folder / "families" / f"{given}.yaml" for folder in reader.folders()[:-1]]
    for path in places:
        if path.is_file():
            return path
    known = ", ".join(families()) or "none is installed"
    raise ScenarioError(f"{given}: no such family: expected one of: {known}, or a file")


def family_from_text(text: str, source: str = "family") -> Family:
    """A family from YAML text; ScenarioError when it is none."""
    tree = reader.parse(text, source)
    try:
        return Family.model_validate(tree)
    except ValidationError as error:
        raise scenario_error(source, error, tree) from None


Generator = Callable[[str], np.random.Generator]
_MOST_TRIES = 200
_ASIDE_M = 3.0  # obstacles lie so far around starts and goals at most
_HEIGHT_M = 5.0
_STEP_S = 0.05


def _number(value: float | tuple[float, float], rng: np.random.Generator) -> float:
    if isinstance(value, tuple):
        return float(rng.uniform(*value))
    return float(value)


def _count(value: int | tuple[int, int], rng: np.random.Generator) -> int:
    if isinstance(value, tuple):
        return int(rng.integers(value[0], value[1] + 1))
    return value


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


def _places(kind: str, size: int, spacing: float, rng: np.random.Generator) -> Array:
    """Places (N, 3) [m] relative to the leader, which is the first; random ones are apart from each other."""
    if kind != "random":
        return SHAPES[kind](size, spacing)
    half = 1.5 * spacing * math.sqrt(size) * np.array([1.0, 1.0, 0.25])
    places = [np.zeros(3)]
    while len(places) < size:
        place = half * rng.uniform(-1.0, 1.0, 3)
        if min(math.hypot(*(place - other)[:2]) for other in places) >= spacing:
            places.append(place)
    return np.array(places)


def _path(path: FamilyPath, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
    """The leader's trajectory, and what was drawn for it."""
    kind = _one_of(path.kinds, rng)
    speed, radius = _number(path.speed_m_s, rng), _number(path.radius_m, rng)
    angle = float(rng.uniform(-math.pi, math.pi))
    hover = {"kind": "line", "position_m": [0.0, 0.0, _HEIGHT_M]}
    if kind == "hover":
        return hover, {"path": kind, "speed_m_s": 0.0, "radius_m": None}
    if kind == "line":
        velocity = [speed * math.cos(angle), speed * math.sin(angle), 0.0]
        drawn = {"path": kind, "speed_m_s": speed, "radius_m": None}
        return hover | {"velocity_m_s": velocity}, drawn
    centre = [0.0, -radius, _HEIGHT_M]  # begins above the origin
    circle = {"kind": "circle", "centre_m": centre, "radius_m": radius}
    drawn = {"path": kind, "speed_m_s": speed, "radius_m": radius}
    return circle | {"rate_rad_s": speed / radius}, drawn


def _starts(
    starts: FamilyStarts, goals: Array, spacing: Spacing, rng: np.random.Generator
) -> list[Array]:
    rule = Starts(NEAR, (_number(starts.sigma_m, rng),))
    if starts.kind == "box":
        rule = Starts(BOX, starts.box_m)
    places = goals
    if starts.kind == "swap":  # a cycle: nobody keeps its place
        cycle = 1 + rng.permutation(len(goals) - 1)
        places = goals.copy()
        places[cycle] = goals[np.roll(cycle, 1)]
    if starts.kind == "opposite":
        places = 2.0 * goals[0] - goals
    return drawn_places(places, rule, spacing, rng)


def _places_due(goals: Array, trajectory: dict[str, Any], tree: Tree) -> Array:
    """The places (N, T, 3) [m] from the deadline to the end of the flight."""
    timing, deadline_s = tree["timing"], tree["gains"]["formation"]["deadline_s"]
    times = np.arange(deadline_s, timing["duration_s"], _STEP_S)
    path = {"line": Line, "circle": Circle}[trajectory["kind"]](**trajectory)
    lead = curve_samples(trajectory_of(path), times)[:, :3]
    return np.asarray(lead + (goals - goals[0])[:, None])


def _obstacles(
    block: FamilyObstacles,
    starts: Array,
    goals: Array,
    due: Array,
    margin_m: float,
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """As many as there is room for: none holds a start, or a place (N, T, 3) when it is due; none meets another one."""
    obstacles: list[dict[str, Any]] = []
    ends = np.concatenate([starts, goals])
    low, high = ends.min(axis=0) - _ASIDE_M, ends.max(axis=0) + _ASIDE_M
    ends = np.concatenate([ends, due.reshape(-1, 3)])
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
                np.linalg.norm(place - np.array(other["position_m"])) > radius + other["keep_out_m"]
                for other in obstacles
            ):
                name = f"O{len(obstacles) + 1}"
                obstacles.append({"name": name, "position_m": place.tolist(), "keep_out_m": radius})
                break
    return obstacles


def draw_family(
    family: Family, base: ScenarioFile, tree: Tree, generator: Generator
) -> dict[str, Any]:
    """Draw a scenario of the family into `tree`, the keys of the base scenario; returns what was drawn, by column.

    `generator` makes the random numbers of one quantity by its name: none depends on what else is drawn.
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
    kept = spacing_of(base, ())
    least_m = kept.uavs_m
    apart = replace(kept, uavs_m=max(least_m, family.starts.apart_m))
    starts = _starts(family.starts, goals, apart, generator("family starts"))
    places = np.array(starts)
    drawn_s = None
    if family.deadline is not None:
        rng = generator("family deadline")
        drawn_s = _draw_deadline(family.deadline, base, tree, places, goals, rng)
    if family.obstacles is not None:
        room, rng = margin_m + least_m, generator("family obstacles")
        due = _places_due(goals, trajectory, tree)
        world["obstacles"] = _obstacles(family.obstacles, places, goals, due, room, rng)
    # Attitudes and disturbances are those of the base scenario's UAVs, over and over.
    given, ids = tree["uavs"], list(range(2, size + 1))
    tree["uavs"] = [
        {**deepcopy(given[row % len(given)]), "id": row + 1, "position_m": place.tolist()}
        for row, place in enumerate(starts)
    ]
    edges = [[uav, uav + 1] for uav in ids[:-1]]
    graph = {"tree": parents, "leader_links": ids, "estimator_edges": edges, "links": []}
    tree["communication"] = {**tree["communication"], **graph}
    tree["leader"] = {"id": 1, "trajectory": trajectory}
    followers = {uav + 1: offsets[uav].tolist() for uav in range(1, size)}
    tree["formation"] = {**tree["formation"], "offsets_m": followers}
    tree["formation"].pop("shape", None)
    for key, value in (("task", family.task), ("assignment", family.assignment)):
        if value is not None:
            tree["formation"][key] = value
    values |= {"size": size, "tree": tree_kind, "shape": shape, "spacing_m": spacing}
    values["obstacles"] = len(world["obstacles"])
    if drawn_s is not None:
        values["deadline_s"] = drawn_s
    values |= _draw_surroundings(family, tree, generator)
    return values


def _draw_deadline(
    block: FamilyDeadline,
    base: ScenarioFile,
    tree: Tree,
    starts: Array,
    goals: Array,
    rng: np.random.Generator,
) -> float:
    """Draw the deadline and the length of the flight."""
    if block.seconds is not None:
        deadline_s = _number(block.seconds, rng)
    else:
        assert block.of_feasible is not None
        beside = starts - starts[0] - (goals - goals[0])
        errors = [float(np.linalg.norm(starts[0] - goals[0])), *np.linalg.norm(beside, axis=1)]
        limits = base.gains.filter
        shortest = feasible_deadline(
            float(max(errors)), limits.max_speed_m_s, limits.max_acceleration_m_s2
        )
        deadline_s = max(_number(block.of_feasible, rng) * shortest, block.at_least_s)
    formation = {**tree["gains"].get("formation", {}), "deadline_s": deadline_s}
    tree["gains"] = {**tree["gains"], "formation": formation}
    tree["timing"] = {**tree["timing"], "duration_s": deadline_s + block.after_s}
    return deadline_s


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
    if family.mass is not None:  # a factor of each UAV, and of each of its axes
        rng = generator("family mass")
        for uav in tree["uavs"]:
            uav["mass_scale"] = _number(family.mass.mass_scale, rng)
            uav["inertia_scale"] = [_number(family.mass.inertia_scale, rng) for _ in range(3)]
        scales = [uav["mass_scale"] for uav in tree["uavs"]]
        values |= {"heaviest": max(scales), "lightest": min(scales)}
    return values
