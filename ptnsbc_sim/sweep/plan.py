"""The flights of a sweep: a base scenario, the keys that vary, and the scenario of each draw.

Draw k is a pure function of the plan and k. It does not depend on the number of draws, of workers or of chunks.
"""

from __future__ import annotations

import dataclasses
import json
import math
import zlib
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy.special import ndtr

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.wire import LARGEST_POSITION_M
from ptnsbc_sim.disturbances import random_streams
from ptnsbc_sim.scenario import Scenario, scenario_from_text
from ptnsbc_sim.scenario.mission.legs import takes_off
from ptnsbc_sim.scenario.problems import Tree
from ptnsbc_sim.scenario.reading import reader
from ptnsbc_sim.scenario.scenario import scenario_of, validated
from ptnsbc_sim.sweep.draws import (
    FILE,
    FROM_FILE,
    Coordinates,
    Spacing,
    Starts,
    SweepAxis,
    SweepError,
    drawn_places,
    spacing_of,
)
from ptnsbc_sim.sweep.family import Generator, draw_family, family_from_text

FORMAT = 1

MOST_DRAWS = 10_000_000
"""Flights of a sweep at most."""
_MEASURED, _MOST_NUMBERS = 64, 128  # draws that tell a layout, and numbers of a quantity in it

Value = float | int | str | bool | None
"""A drawn value as a column of the table holds it."""


@dataclass(frozen=True)
class SweepPlan:
    """The flights of a sweep.

    Axes of a list or a grid make a grid of all their combinations, each of which is flown `runs` times. Axes of
    a range are drawn for every flight. Draw k is flight k // cells of grid cell k % cells.
    """

    scenario: str
    """Text of the base scenario, after `extends` and with all overrides of plant, task, profile and avoidance."""
    runs: int
    """Flights of each cell of the grid; of all, when there is no grid."""
    seed: int = 0
    axes: tuple[SweepAxis, ...] = ()
    starts: Starts = FROM_FILE
    family: str = ""
    """Text of a family of scenarios; empty: the base scenario as it is."""
    stop_after_s: float | None = None
    """Each flight ends at this time after its start, or with the scenario's duration when that is shorter."""
    check: int = 0
    """Perturbed flights of the dry run before each draw; 0: no dry run."""
    points: tuple[tuple[float, ...], ...] = ()
    """A point of the standard normal space for each draw, as a search has found them; empty: random draws."""
    layout: tuple[tuple[str, int], ...] = ()
    """The quantities that the coordinates of a point make, in their order, and how many each has."""
    name: str = "sweep"
    source: str = "scenario"
    """The origin of the base scenario, for messages."""

    @property
    def grid(self) -> tuple[SweepAxis, ...]:
        """The axes whose values make the grid."""
        return tuple(axis for axis in self.axes if not axis.random)

    @property
    def ranges(self) -> tuple[SweepAxis, ...]:
        """The axes that are drawn for every flight."""
        return tuple(axis for axis in self.axes if axis.random)

    @property
    def cells(self) -> int:
        """Combinations of the grid's values."""
        return math.prod(len(axis.values) for axis in self.grid)

    @property
    def draws(self) -> int:
        """Flights in all."""
        return self.runs * self.cells

    def to_json(self) -> str:
        """The plan as text: the same plan gives the same text."""
        plain = {"format": FORMAT, **dataclasses.asdict(self)}
        return json.dumps(plain, sort_keys=True, ensure_ascii=False, indent=1)

    @classmethod
    def from_json(cls, text: str) -> SweepPlan:
        """The plan that `to_json` wrote."""
        plain = json.loads(text)
        if plain.pop("format", None) != FORMAT:
            raise SweepError(f"plan of another format: expected format {FORMAT}")
        axes = (SweepAxis(**{**axis, "values": tuple(axis["values"])}) for axis in plain["axes"])
        starts = Starts(plain["starts"]["kind"], tuple(plain["starts"]["numbers"]))
        listed = {key: tuple(map(tuple, plain[key])) for key in ("points", "layout")}
        return cls(**{**plain, "axes": tuple(axes), "starts": starts, **listed})


def plan_of(scenario: Scenario, runs: int, **rest: Any) -> SweepPlan:
    """A plan over a scenario that has been loaded with its overrides; `rest` are fields of SweepPlan.

    SweepError when it has no flight, or an axis that cannot be; ScenarioError when its first draw is no scenario.
    """
    plan = SweepPlan(scenario.text, runs, source=scenario.source, **rest)
    if runs < 1 or plan.draws > MOST_DRAWS:
        flights = f" in {plan.cells} cells" if plan.cells > 1 else ""
        raise SweepError(f"runs: {runs}{flights}: expected 1 to {MOST_DRAWS} flights in all")
    keys = [axis.key for axis in plan.axes]
    if len(set(keys)) < len(keys):
        raise SweepError(f"vary: a key stands twice: {', '.join(keys)}")
    drawn_scenario(plan, 0)
    return plan


def generator(plan: SweepPlan, k: int, name: str) -> np.random.Generator:
    """Random numbers of one quantity of draw k, whatever else is drawn."""
    word = zlib.crc32(name.encode())
    if not plan.points:
        return random_streams.generator(plan.seed, k, word)
    begin, point = 0, np.array(plan.points[k])
    for other, count in plan.layout:
        if other == name:
            break
        begin += count
    else:
        count = 0
    return Coordinates(ndtr(point[begin : begin + count]).tolist(), zlib.crc32(point.data, word))


def layout_of(plan: SweepPlan) -> tuple[tuple[str, int], ...]:
    """The quantities of a draw and the numbers that each needs, by the most that some random draws have used."""
    most: Counter[str] = Counter()
    for k in range(min(_MEASURED, plan.draws)):
        asked: dict[str, Coordinates] = {}

        def numbers(name: str, k: int = k, asked: dict[str, Coordinates] = asked) -> Coordinates:
            seed = zlib.crc32(name.encode(), k)
            return asked.setdefault(name, Coordinates((), seed))

        with suppress(SweepError):  # starts without room
            _drawn(plan, k, numbers)
        most |= Counter({name: min(of.used, _MOST_NUMBERS) for name, of in asked.items()})
    return tuple(most.items())


_family = lru_cache(maxsize=4)(family_from_text)


def _axis_values(plan: SweepPlan, k: int, numbers: Generator) -> dict[str, Any]:
    found: dict[str, Any] = {}
    cell = k % plan.cells
    for axis in reversed(plan.grid):  # the last axis varies fastest
        cell, which = divmod(cell, len(axis.values))
        found[axis.key] = axis.values[which]
    for axis in plan.ranges:
        found[axis.key] = axis.at(float(numbers(axis.key).random()))
    return {axis.key: found[axis.key] for axis in plan.axes}


def axis_values(plan: SweepPlan, k: int) -> dict[str, Value]:
    """The values of the axes of draw k, as columns hold them."""
    found = _axis_values(plan, k, partial(generator, plan, k))
    return {key: _plain(value) for key, value in found.items()}


def _drawn(
    plan: SweepPlan, k: int, numbers: Generator | None = None
) -> tuple[Tree, dict[str, Value]]:
    """The scenario tree of draw k, and what was drawn for it."""
    numbers = numbers or partial(generator, plan, k)
    if not 0 <= k < plan.draws:
        raise SweepError(f"draw {k}: expected 0 to {plan.draws - 1}")
    tree = reader.parse(plan.scenario, plan.source)
    values: dict[str, Value] = {}
    if plan.family:
        base = _base_scenario(plan.scenario, plan.source)
        values |= draw_family(_family(plan.family), base, tree, numbers)
    axes = _axis_values(plan, k, numbers)
    tree = reader.with_keys(tree, axes, plan.source)
    values |= {key: _plain(value) for key, value in axes.items()}
    if "seed" not in axes:
        tree["seed"] = int(numbers("seed").integers(2**32))
    if plan.starts.kind == FILE and plan.stop_after_s is None:
        return tree, values
    file = validated(tree, _source(plan, k))
    if plan.starts.kind != FILE:
        given = [uav.position_m for uav in file.uavs]
        spacing = spacing_of(file, file.world.bodies)
        places = drawn_places(given, plan.starts, spacing, numbers("starts"))
        for uav, place in zip(tree["uavs"], places, strict=True):
            uav["position_m"] = place.tolist()
    if plan.stop_after_s is not None:
        tree["timing"]["duration_s"] = min(file.timing.duration_s, float(plan.stop_after_s))
    return tree, values


def _plain(value: Any) -> Value:
    """A value as a column holds it: numbers and words as they are, all else as JSON."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return json.dumps(value)


def _source(plan: SweepPlan, k: int) -> str:
    return f"{plan.source}, draw {k}"


def drawn_values(plan: SweepPlan, k: int) -> dict[str, Value]:
    """The values of draw k: those of the axes, and those of a family."""
    return _drawn(plan, k)[1]


def draw(plan: SweepPlan, k: int) -> Scenario:
    """The scenario of draw k, with its text, as `simulate --draw K` flies it."""
    tree, _ = _drawn(plan, k)
    return scenario_from_text(reader.dump(tree), source=_source(plan, k))


def drawn_scenario(plan: SweepPlan, k: int) -> tuple[Scenario, Mapping[str, Value]]:
    """The scenario of draw k for the loop, and what was drawn: no YAML is written and read, so `text` is empty."""
    if not plan.family and not plan.axes and 0 <= k < plan.draws:
        found = _with_starts_alone(plan, k)
        if found is not None:
            return found, {}
    tree, values = _drawn(plan, k)
    source = _source(plan, k)
    return scenario_of(validated(tree, source), "", source), values


@lru_cache(maxsize=4)
def _base_scenario(text: str, source: str) -> Scenario:
    return scenario_from_text(text, source=source)


@lru_cache(maxsize=4)
def _common(text: str, source: str, stop_after_s: float | None) -> tuple[Scenario, Spacing]:
    """The scenario of draws that differ in starts and seed only, and the distances that starts must keep."""
    scenario = _base_scenario(text, source)
    if stop_after_s is not None:
        stop_s = min(scenario.timing.duration_s, float(stop_after_s))
        scenario = scenario_from_text(text, {"timing.duration_s": stop_s}, source=source)
    spacing = spacing_of(scenario, scenario.world.bodies)
    return scenario.model_copy(update={"text": ""}), spacing


def _with_starts_alone(plan: SweepPlan, k: int) -> Scenario | None:
    """The scenario of a draw without axes and family; None where its starts are to be validated.

    No check of a scenario looks at seed and starts, but that they are not too far: the base scenario is validated
    once, and every draw shares its blocks. A take-off is the exception, as it makes places and path of the starts.
    """
    source = _source(plan, k)
    try:
        base, spacing = _common(plan.scenario, plan.source, plan.stop_after_s)
    except PtnsbcError:
        return None  # whoever validates the draw names it in the message
    seed = int(generator(plan, k, "seed").integers(2**32))
    update: dict[str, Any] = {"seed": seed, "source": source}
    if plan.starts.kind != FILE:
        if takes_off(base.mission):
            return None
        given = [uav.position_m for uav in base.uavs]
        places = drawn_places(given, plan.starts, spacing, generator(plan, k, "starts"))
        if not (np.linalg.norm(places, axis=1) < LARGEST_POSITION_M).all():
            return None
        update["uavs"] = tuple(
            uav.model_copy(update={"position_m": tuple(place.tolist())})
            for uav, place in zip(base.uavs, places, strict=True)
        )
    return base.model_copy(update=update)
