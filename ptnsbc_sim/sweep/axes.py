"""One axis of a sweep: a dotted key of the scenario and the values that it takes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario.reading.reader import parse

_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_RANGE = re.compile(rf"\s*{_NUMBER}\s*:\s*{_NUMBER}\s*")
_GRID = re.compile(rf"\s*{_NUMBER}\s*:\s*{_NUMBER}\s*:\s*(\d+)\s*")
_NORMAL = re.compile(rf"\s*{_NUMBER}\s*(?:±|\+-)\s*{_NUMBER}\s*")
_LEAST = 2.0**-54  # a share of 0 would be an infinite normal number

UNIFORM, NORMAL, VALUES = "uniform", "normal", "values"


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
    if count < 2:
        raise SweepError(f'vary "{text}": expected at least 2 points')
    points = [float(value) for value in np.linspace(low, high, count)]
    whole = all("." not in part and "e" not in part.lower() for part in match.groups())
    if whole and all(point.is_integer() for point in points):
        return tuple(int(point) for point in points)  # a key such as sensor.rate_hz takes no 10.0
    return tuple(points)
