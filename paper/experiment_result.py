"""The result of an experiment of `ptnsbc reproduce`: figures, tables and claims as plain data."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from ptnsbc_core.errors import PtnsbcError

Cell = str | float | int | None

_DIGITS = 6  # of a number in results.json: further digits differ between processors


class ReproduceError(PtnsbcError):
    """An experiment that cannot be run, or a folder that cannot take its results."""


@dataclass(frozen=True)
class Figure:
    """One figure; its files are figures/<name>.png and .svg, and curves/<name>.csv."""

    name: str  # fig_05_trajectories_3d
    title: str  # Fig. 5
    caption: str
    telling: bool = False  # docs/tables.md shows it


@dataclass(frozen=True)
class Column:
    """Heading of a column with its unit, and the decimals of its numbers."""

    title: str
    digits: int = 2


@dataclass(frozen=True)
class Table:
    """A small table and what it means."""

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    meaning: str


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper in our words, its number and ours."""

    key: str
    said: str
    number: str
    ours: str
    verdict: str  # holds | holds when ... | does not hold
    figures: str


@dataclass(frozen=True)
class ExperimentResult:
    """The results of one experiment."""

    name: str
    title: str
    text: str  # what was flown, in a few sentences
    figures: tuple[Figure, ...] = ()
    tables: tuple[Table, ...] = ()
    claims: tuple[Claim, ...] = ()
    timed: bool = False  # contains measured times: two runs differ

    def as_json(self) -> dict[str, Any]:
        """Plain types; numbers are rounded, and a number that does not exist is null."""
        plain: dict[str, Any] = rounded(dataclasses.asdict(self))
        return plain


def rounded(value: Any) -> Any:
    """A tree of plain values with its floats rounded to six significant digits."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
    return value


def cell_text(cell: Cell, digits: int = 2) -> str:
    """A cell as text."""
    if cell is None:
        return "–"
    return f"{cell:.{digits}f}" if isinstance(cell, float) else str(cell)
