"""Tables of numbers as text: the one reader of trajectories, streams, shapes and maps.

A row of names decides which column is which, and in which unit; without names the order of the columns does. Commas,
semicolons, tabs or spaces stand between numbers; where commas do not, they may be decimal.
"""

from __future__ import annotations

import csv
import math
import re
from array import array
from collections.abc import Iterator, Sequence

import numpy as np

from ptnsbc_core.curves.trajectory import COEFFICIENTS
from ptnsbc_core.types import Array

COEFFICIENT_NAMES = tuple(f"{axis}^{k}" for axis in (*"xyz", "yaw") for k in range(COEFFICIENTS))
"""Columns of polynomials of a path, behind `duration`: x^0 is the lowest power of x."""

_SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6}
_SECONDS |= {"usec": 1e-6, "ns": 1e-9, "nsec": 1e-9}
_METRES = {"m": 1.0, "metres": 1.0, "meters": 1.0, "cm": 0.01, "mm": 1e-3, "km": 1e3, "ft": 0.3048}
_RADIANS = {"rad": 1.0, "radians": 1.0} | dict.fromkeys(("deg", "degrees", "°"), math.pi / 180)
_UNITS = {"t": _SECONDS, "yaw": _RADIANS} | dict.fromkeys("xyz", _METRES)
_UNITS |= {f"v{axis}": {**_METRES, "s": 1.0} for axis in "xyz"}
_UNITS |= {f"q{axis}": {} for axis in "xyzw"} | {key: {} for key in COEFFICIENT_NAMES}
_UNITS["duration"] = _SECONDS
_ALIASES = {"t": {"t", "time", "timestamp"}, "yaw": {"yaw", "heading"}}
_ALIASES |= {axis: {axis, f"t{axis}"} for axis in "xyz"}  # TUM: tx
_BESIDE = {"pos", "position", "pose", "point", "enu"}  # words that change nothing
_NAMES = _UNITS.keys() | set[str]().union(*_ALIASES.values())
_WORD = re.compile(r"(?:[A-Z]?[^\W\d_A-Z]+|[A-Z]+)(?:\^\d)?|°")


def read_table(
    text: str, columns: Sequence[str], *, optional: int = 0, loose: bool = False
) -> Array:
    """The rows (R, W) of a table, in s, m, rad and m/s; lines of comments (#) and empty ones are left out.

    Args:
        text: the table.
        columns: names in their order, of `t x y z vx vy vz qx qy qz qw yaw`, `duration` and COEFFICIENT_NAMES where the
            table may have names.
        optional: of the columns at the end: they are in all rows or in none.
        loose: rows without names may be longer, and numbers infinite or none.

    Raises:
        ValueError: a row or a name that does not fit, in words that follow a key.
    """
    least = len(columns) - optional
    beside = f" and, in all rows or none, {', '.join(columns[least:])}" if optional else ""
    expected = ", ".join(columns[:least]) + beside
    numbers, picked, width, named = array("d"), list[tuple[int, float]](), 0, False
    for at, cells in _records(text):
        if not width:
            named = not all(map(_is_number, cells[:least]))
            if named and any(map(_is_number, cells)):
                raise ValueError(f"row {at}: expected numbers {expected}, or names of columns")
            width = len(cells)
            if named:
                picked = list(_picked(at, cells, columns, least))
                continue
            picked = [(column, 1.0) for column in range(min(width, len(columns)))]
        fits = len(cells) == width and (named or width <= len(columns))
        free = loose and not named and len(cells) > max(picked)[0]
        if len(picked) < least or not (fits or free):
            wanted = f"{width}, one for each name" if named else expected
            raise ValueError(f"row {at}: {len(cells)} numbers: expected {wanted}")
        try:
            row = [float(cells[column].replace(",", ".")) * factor for column, factor in picked]
        except ValueError:
            raise ValueError(f"row {at}: expected numbers {expected}") from None
        if not loose and not all(map(math.isfinite, row)):
            raise ValueError(f"row {at}: expected finite numbers")
        numbers.extend(row)
    return np.array(numbers).reshape(-1, len(picked) if width else len(columns))


def head_of(text: str) -> tuple[int, set[str]]:
    """The number of columns of a table, and the words of their names; a table of mere numbers has none."""
    cells = next((cells for _, cells in _records(text)), [])
    named = not any(map(_is_number, cells))
    return len(cells), set[str]().union(*map(_words, cells)) if named else set()


def _records(text: str) -> Iterator[tuple[int, list[str]]]:
    """The number and the cells of each line that is neither empty nor a comment; a first comment may hold the names."""
    lines = text.removeprefix("\ufeff").splitlines()  # Excel begins a CSV file with a mark
    first = next((line for line in lines if line.strip(" ,;\t") and line.lstrip()[0] != "#"), "")
    mark = next((mark for mark in ";\t," if mark in first.strip()), " ")
    reader = csv.reader(lines, delimiter=mark, skipinitialspace=True)
    width = 0
    try:
        for cells in reader:
            while cells[width:] and not cells[-1].strip():  # after a mark at the end of a row
                cells.pop()
            if not any(map(str.strip, cells)):
                continue
            if cells[0].startswith(("#", "//", "sep=")):
                cells = [cell for cell in [cells[0].lstrip("#/ "), *cells[1:]] if cell]
                if width or sum(not _words(cell).isdisjoint(_NAMES) for cell in cells) < 3:
                    continue
            width = width or len(cells)
            yield reader.line_num, cells
    except csv.Error as error:
        raise ValueError(f"row {reader.line_num}: {error}: expected text of a table") from None


def _words(name: str) -> set[str]:
    return {word.lower() for word in _WORD.findall(name)}


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _picked(
    at: int, names: Sequence[str], columns: Sequence[str], least: int
) -> Iterator[tuple[int, float]]:
    """The place of each column in a row of names, and the factor of its unit."""
    words = [_words(name) for name in names]
    for order, key in enumerate(columns):
        aliases, units = _ALIASES.get(key, {key}), _UNITS[key]
        near = [place for place, of in enumerate(words) if of & aliases]
        fits = [place for place in near if words[place] - aliases - _BESIDE <= units.keys()]
        if not near and order >= least:
            return
        if len(fits) != 1:
            of = ", ".join(names[place].strip() for place in near or range(len(names)))
            known = ", ".join(units)
            raise ValueError(f"row {at}: column {of[:60]}: expected one named {key}, in {known}")
        yield fits[0], math.prod(units[word] for word in words[fits[0]] - aliases - _BESIDE)
