"""The draws of a sweep: values of keys of the scenario, and the starts of the UAVs."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.model import ScenarioFile
from ptnsbc_sim.scenario.obstacles import Obstacle
from ptnsbc_sim.scenario.reading.reader import parse

_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_RANGE = re.compile(rf"\s*{_NUMBER}\s*:\s*{_NUMBER}\s*")
_GRID = re.compile(rf"\s*{_NUMBER}\s*:\s*{_NUMBER}\s*:\s*(\d+)\s*")
_NORMAL = re.compile(rf"\s*{_NUMBER}\s*(?:±|\+-)\s*{_NUMBER}\s*")
_MOST_POINTS = 10_000  # of a grid: the plan holds each
_LEAST = 2.0**-54  # a share of 0 would be an infinite normal number

UNIFORM, NORMAL, VALUES = "uniform", "normal", "values"


class Coordinates(np.random.Generator):
    """The numbers of one quantity, the first of them given: each goes through the inverse of its distribution.

    What a rejected place uses beyond those that are given comes from the seed.
    """

    def __init__(self, shares: Sequence[float], seed: int) -> None:
        """`shares` (D,) in [0, 1), in the order in which they are asked for."""
        super().__init__(np.random.PCG64(seed))
        self._shares, self.used = shares, 0

    def random(self, size: Any = None, *_: Any, **__: Any) -> Any:
        """Shares, of the shape `size`, or one."""
        wanted = math.prod(np.atleast_1d(1 if size is None else size))
        given = self._shares[self.used : self.used + wanted]
        self.used += int(wanted)
        found = np.concatenate([given, super().random(wanted - len(given))])
        return found.reshape(size) if size is not None else float(found[0])

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> Any:
        """Numbers from `low` to `high`."""
        shape = np.broadcast_shapes(np.shape(low), np.shape(high)) or None
        return low + (np.asarray(high) - low) * self.random(shape if size is None else size)

    def integers(self, low: Any, high: Any = None, *_: Any, **__: Any) -> Any:
        """One integer from `low`, or 0, to below `high`."""
        low, high = (0, low) if high is None else (low, high)
        return int(low + (high - low) * self.random())

    def standard_normal(self, size: Any = None, *_: Any, **__: Any) -> Any:
        """Normal numbers."""
        return ndtri(np.maximum(self.random(size), _LEAST))

    def permutation(self, x: Any, *_: Any, **__: Any) -> Any:
        """The numbers below `x` in another order."""
        return np.argsort(self.random(x), kind="stable")


class SweepError(PtnsbcError):
    """A sweep that cannot be flown as asked."""


@dataclass(frozen=True)
class SweepAxis:
    """A dotted key of the scenario (`gains.formation.deadline_s`, `uavs[0].position_m[2]`) that varies."""

    key: str
    kind: str  # uniform | normal | values
    values: tuple[Any, ...]  # (low, high), (mean, standard deviation), or every value

    @property
    def random(self) -> bool:
        """True if a value is drawn; otherwise the axis is one of the grid."""
        return self.kind != VALUES

    def at(self, share: float) -> float:
        """The value below which this share of the draws lies."""
        first, second = (float(value) for value in self.values)
        if self.kind == UNIFORM:
            return first + (second - first) * share
        return float(first + second * ndtri(max(share, _LEAST)))


def parse_axis(text: str) -> SweepAxis:
    """An axis from KEY=LO:HI (uniform), KEY=MEAN±SIGMA (normal), KEY=LO:HI:N (grid) or KEY=A,B,C (list)."""
    key, found, value = text.partition("=")
    key = key.strip()
    if not found or not key or not value.strip():
        raise SweepError(
            f'vary "{text}": expected KEY=LO:HI, KEY=MEAN±SIGMA, KEY=LO:HI:N or KEY=A,B,C'
        )
    if match := _GRID.fullmatch(value):
        return SweepAxis(key, VALUES, _grid(text, match))
    if match := _RANGE.fullmatch(value):
        low, high = float(match[1]), float(match[2])
        if not low < high:
            raise SweepError(f'vary "{text}": expected LO below HI')
        return SweepAxis(key, UNIFORM, (low, high))
    if match := _NORMAL.fullmatch(value):
        if not float(match[2]) > 0.0:
            raise SweepError(f'vary "{text}": expected a standard deviation above 0')
        return SweepAxis(key, NORMAL, (float(match[1]), float(match[2])))
    listed = parse(f"values: [{value}]", f'vary "{text}"')["values"]
    return SweepAxis(key, VALUES, tuple(listed))


def _grid(text: str, match: re.Match[str]) -> tuple[float | int, ...]:
    low, high, count = float(match[1]), float(match[2]), int(match[3])
    if not 2 <= count <= _MOST_POINTS:
        raise SweepError(f'vary "{text}": expected 2 to {_MOST_POINTS} points')
    points = [float(value) for value in np.linspace(low, high, count)]
    whole = all("." not in part and "e" not in part.lower() for part in match.groups())
    if whole and all(point.is_integer() for point in points):
        return tuple(int(point) for point in points)  # a key such as sensor.rate_hz takes no 10.0
    return tuple(points)


FILE, NEAR, BOX = "file", "near", "box"
_MOST_TRIES = 1000


@dataclass(frozen=True)
class Starts:
    """The rule by which the starts are drawn.

    `near`: each coordinate of the file's start plus a normal number. `box`: uniform in X by Y by Z metres,
    around the mean of the file's starts horizontally, and from the lowest of them upwards. A start is drawn
    again while another UAV is closer than formation.uav_keep_out_m plus the margin of gains.clearance, or an
    obstacle closer than its keep_out_m plus that margin. Attitudes stay as they are in the file.
    """

    kind: str = FILE  # file | near | box
    numbers: tuple[float, ...] = ()  # near: standard deviation [m]; box: its edges [m]


FROM_FILE = Starts()


def parse_starts(text: str) -> Starts:
    """Starts from `file`, `near:SIGMA` or `box:X,Y,Z` (metres)."""
    kind, _, rest = text.partition(":")
    expected = f'starts "{text}": expected file, near:SIGMA or box:X,Y,Z with metres above 0'
    try:
        numbers = tuple(float(part) for part in rest.split(",")) if rest else ()
    except ValueError:
        raise SweepError(expected) from None
    if len(numbers) != {FILE: 0, NEAR: 1, BOX: 3}.get(kind) or min(numbers, default=1.0) <= 0.0:
        raise SweepError(expected)
    return Starts(kind, numbers)


@dataclass(frozen=True)
class Spacing:
    """The distances that a start must keep."""

    uavs_m: float  # from every other UAV, in the scale of their keep-outs
    bodies: tuple[tuple[Obstacle, float], ...] = ()  # from each body [m]
    scale: Array | float = 1.0  # `keep_out_scale`


def _is_clear(place: Array, others: Sequence[Array], spacing: Spacing) -> bool:
    if any(np.linalg.norm((place - other) * spacing.scale) < spacing.uavs_m for other in others):
        return False
    at = place[None], np.zeros(1)
    return all(body.distances(*at)[0] >= least_m for body, least_m in spacing.bodies)


def spacing_of(file: ScenarioFile, bodies: Sequence[Obstacle]) -> Spacing:
    """The distances that the starts of a scenario must keep, with these bodies in its world."""
    margin_m = float(file.gains.clearance.margin_m)
    return Spacing(
        max(file.formation.uav_keep_out_m, *map(file.keep_out_m, file.uav_ids)) + margin_m,
        tuple((body, body.keep_out_m + margin_m) for body in bodies),
        file.formation.keep_out_scale,
    )


def drawn_places(
    positions: Sequence[Sequence[float]] | Array,
    starts: Starts,
    spacing: Spacing,
    rng: np.random.Generator,
) -> list[Array]:
    """The starts (3,) [m] of all UAVs, whose positions in the file are given; not for `file`.

    Each is clear of the bodies and of the starts before it.
    """
    centres = [np.array(place, dtype=np.float64) for place in positions]
    spread = np.full(3, starts.numbers[0])
    if starts.kind == BOX:
        spread = 0.5 * np.array(starts.numbers)
        centre = np.mean(centres, axis=0)
        centre[2] = min(place[2] for place in centres) + spread[2]
        centres = [centre] * len(centres)
    places: list[Array] = []
    for number, centre in enumerate(centres):
        for _ in range(_MOST_TRIES):
            near = starts.kind == NEAR
            share = rng.standard_normal(3) if near else rng.uniform(-1.0, 1.0, 3)
            place = centre + spread * share
            if _is_clear(place, places, spacing):
                places.append(place)
                break
        else:
            raise SweepError(
                f"starts: no room for UAV number {number + 1} of {len(centres)} after {_MOST_TRIES} "
                f"tries: expected {spacing.uavs_m:g} m between UAVs; draw from a larger region"
            )
    return places
