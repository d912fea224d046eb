"""The shape of a formation: a library of shapes, changes at mission times, and the tree that fits a shape.

A scenario names a shape instead of offsets; `completed` puts the offsets into its tree before the schema reads it.
What moves becomes a table of polynomials (ptnsbc_core.curves.piecewise) for each UAV.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from ptnsbc_core.curves.piecewise import COEFFICIENTS
from ptnsbc_core.curves.shape import CHANNELS
from ptnsbc_core.types import Array, Shape
from ptnsbc_sim.scenario.fields import MOST_SAMPLES, Block, Number, UavId, Vec3, three

_RISE = (-20.0, 70.0, -84.0, 35.0)  # h of the time base, the powers 7 to 4
_BINOMIALS = np.array(
    [
        [math.comb(k, j) for j in reversed(range(COEFFICIENTS))]
        for k in reversed(range(COEFFICIENTS))
    ]
)


Factor = Annotated[Number, Field(ge=-1000, le=1000)]


class ShapeBlock(Block):
    """Offsets by the name of a shape."""

    kind: Literal["v", "line", "column", "grid", "circle", "sphere", "file"]
    """`v`: a wedge behind the leader; `line`: side by side; `column`: one behind the other; `grid`: rows behind the
    leader; `circle`, `sphere`: around the leader; `file`: places from a CSV file. Ahead is along x."""
    spacing_m: Annotated[Number, Field(ge=0.01, le=1e4)] | None = None
    """Distance of neighbours; all but `file` need it."""
    file: str | None = None
    """*file* Name of the file, looked for beside the scenario: a row x, y, z for each follower, in the order of `uavs`.
    It becomes `samples` when it is read, so that a bag holds it."""
    samples: Annotated[str, Field(max_length=MOST_SAMPLES)] | None = None
    """*file* The content of such a file [m]; a first row of names is left out."""


class Reshaping(Block):
    """The new shape of the formation."""

    over_s: Annotated[Number, Field(ge=0.1, le=1e6)]
    """Duration: by then the UAVs are in the changed shape."""
    shape: ShapeBlock | None = None
    """Shape to take. The UAVs take the places for which the sum of the squared distances is minimal. Default: the
    present one."""
    offsets_m: dict[UavId, Vec3] | None = None
    """Offsets to take instead of a named shape."""
    scale: Annotated[tuple[Factor, Factor, Factor], BeforeValidator(three)] = (1.0, 1.0, 1.0)
    """Factors on the offsets, along the axes of the shape."""
    shear: Factor = 0.0
    """Metres ahead for each metre to the left."""
    rotation_rad: Factor = 0.0
    """Turn of the shape about the vertical, from its first position."""


class Change(Reshaping):
    """The new shape of the formation, and the time of the change."""

    at_s: Annotated[Number, Field(ge=0, le=1e6)]
    """Begin, after the first epoch."""


def _v(size: int, spacing: float) -> Array:
    """A wedge, the leader at its tip."""
    rows, sides = _arms(size)
    return spacing * np.stack([-0.8 * rows, 0.6 * sides * rows, 0.0 * rows], axis=1)


def _line(size: int, spacing: float) -> Array:
    """Side by side, left and right of the leader in turn."""
    rows, sides = _arms(size)
    return spacing * np.stack([0.0 * rows, sides * rows, 0.0 * rows], axis=1)


def _arms(size: int) -> tuple[Array, Array]:
    """How many places from the leader every UAV is, and on which side: 1 left, -1 right."""
    rows = np.array([(uav + 1) // 2 for uav in range(size)], dtype=np.float64)
    return rows, np.array([1.0 if uav % 2 else -1.0 for uav in range(size)])


def _column(size: int, spacing: float) -> Array:
    """One behind the other."""
    return np.array([[-spacing * uav, 0.0, 0.0] for uav in range(size)])


def _grid(size: int, spacing: float) -> Array:
    """Rows behind the leader, which has a corner."""
    columns = math.ceil(math.sqrt(size))
    return np.array(
        [[-spacing * (uav // columns), spacing * (uav % columns), 0.0] for uav in range(size)]
    )


def _circle(size: int, spacing: float) -> Array:
    """The leader in the middle, the followers around it."""
    followers = max(size - 1, 1)
    radius = max(
        spacing, 0.5 * spacing / math.sin(math.pi / followers) if followers > 1 else spacing
    )
    angles = 2.0 * math.pi * np.arange(followers) / followers
    ring = radius * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    return np.concatenate([np.zeros((1, 3)), ring])[:size]


def _sphere(size: int, spacing: float) -> Array:
    """The leader in the middle, the followers on a sphere, by the golden angle."""
    followers = max(size - 1, 1)
    heights = 1.0 - 2.0 * (np.arange(followers) + 0.5) / followers
    angles = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(followers)
    wide = np.sqrt(1.0 - heights**2)
    ball = np.stack([wide * np.cos(angles), wide * np.sin(angles), heights], axis=1)
    gaps = np.linalg.norm(ball[:, None] - ball[None], axis=2) + 9.0 * np.eye(followers)
    ball *= spacing / min(1.0, float(gaps.min()))
    return np.concatenate([np.zeros((1, 3)), ball])[:size]


SHAPES: Mapping[str, Callable[[int, float], Array]] = {
    "v": _v,
    "line": _line,
    "column": _column,
    "grid": _grid,
    "circle": _circle,
    "sphere": _sphere,
}
"""The shapes: places (N, 3) [m] of N UAVs beside the leader, which is the first, by their spacing [m]. Ahead is x.

The key `shape`, families and `ptnsbc new` take them from here."""


def named_places(block: ShapeBlock, size: int) -> Array:
    """Places (N, 3) [m] of a shape beside its leader, which is the first.

    Raises:
        ValueError: a key is missing, or the file does not fit, in words that follow `shape.`.
    """
    if block.kind == "file":
        return _places_of(block.samples, size)
    if block.spacing_m is None:
        raise ValueError("spacing_m: missing: expected a number in m")
    return SHAPES[block.kind](size, block.spacing_m)


def _places_of(text: str | None, size: int) -> Array:
    """Places (N, 3) [m] from CSV text with a row for each follower."""
    if text is None:
        raise ValueError("file: missing: expected the name of a CSV file, or samples")
    rows = [row for row in csv.reader(text.splitlines()) if row and not row[0].startswith("#")]
    if rows and not _is_number(rows[0][0]):
        rows = rows[1:]
    if len(rows) != size - 1:
        raise ValueError(f"samples: {len(rows)} places: expected {size - 1}, one for each follower")
    try:
        places = np.array([[float(cell) for cell in row] for row in rows]).reshape(-1, 3)
    except ValueError:
        raise ValueError("samples: expected three numbers x, y, z in each row") from None
    if len(places) != len(rows) or not np.isfinite(places).all() or np.abs(places).max() > 1e6:
        raise ValueError("samples: expected three numbers x, y, z in each row, up to 1e6 m")
    return np.concatenate([np.zeros((1, 3)), places])


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def changed(change: Reshaping, place: Array) -> Array:
    """A place (..., 3) scaled and sheared by a change."""
    return np.array(change.scale) * place + change.shear * place[..., 1:2] * np.eye(3)[0]


NO_TABLE = np.zeros((0, 1 + COEFFICIENTS * CHANNELS))
STANDING = Shape(False, False, NO_TABLE)
"""A shape that does not move in itself."""


def moves(formation: Any) -> bool:
    """True if the shape of a formation block moves in itself."""
    return formation.frame == "heading" or bool(formation.changes)


def shape_of(file: Any, uav: int) -> Shape:
    """The motion of the places of a UAV and its parent, in a whole scenario file."""
    formation = file.formation
    if not moves(formation):
        return STANDING
    parent = file.communication.tree.get(uav)
    own, above = _stages(formation, uav), _stages(formation, parent)
    turns = [0.0, *(change.rotation_rad for change in formation.changes)]
    stages = np.concatenate([own, above, np.array(turns)[:, None]], axis=1)
    table = _table(formation.changes, stages)
    for one in getattr(file.leader.trajectory, "apart", ()):
        group = _branch(file.communication.tree, one.head)
        which = [at for at, who in enumerate((uav, parent)) if who in group]
        table = _displaced(table, one.rows, which)
    return Shape(True, formation.frame == "heading", table)


class Apart(NamedTuple):
    """A group that leaves the formation for a while."""

    head: int  # it and all UAVs below it in the tree are the group
    begin_s: float  # when it leaves [s]
    rows: Array  # (K, 25) by what its places are displaced, three channels


def _branch(tree: Mapping[int, int], head: int) -> set[int]:
    """A UAV and all below it in the tree."""
    found = {head}
    while more := {uav for uav, above in tree.items() if above in found} - found:
        found |= more
    return found


def _displaced(table: Array, rows: Array, which: list[int]) -> Array:
    """A table of places, those of the UAV (0) or of its parent (1) displaced."""
    if not which:
        return table
    times = np.union1d(table[:, 0], rows[:, 0])
    table, rows = at_knots(table, times), at_knots(rows, times)
    width = rows.shape[1] - 1
    for at in which:
        table[:, 1 + width * at : 1 + width * (at + 1)] += rows[:, 1:]
    return table


def place_rows(file: Any, uav: int) -> Array:
    """Polynomials (K, 25) of the place of a UAV in the axes of the shape, without what groups are displaced by."""
    return _table(file.formation.changes, _stages(file.formation, uav))


def at_knots(table: Array, times: Array) -> Array:
    """The same polynomials with a row at each of the times (K,), among which all of its own are."""
    rows = np.maximum(np.searchsorted(table[:, 0], times, side="right") - 1, 0)
    since = (times - table[rows, 0])[:, None, None]
    given = table[rows, 1:].reshape(len(times), -1, COEFFICIENTS)
    power = np.arange(COEFFICIENTS)[::-1]  # of each coefficient
    rise = power[:, None] - power[None, :]  # from a new power to that of a given one
    shift = np.where(rise >= 0, _BINOMIALS * since ** np.maximum(rise, 0), 0.0)
    moved = (given[:, :, :, None] * shift[:, None]).sum(axis=2)
    return np.column_stack([times, moved.reshape(len(times), -1)])


def summed(one: Array, other: Array, sign: float = 1.0) -> Array:
    """A table with `sign` times the first three channels of another one added to its own, at the knots of both."""
    times, width = np.union1d(one[:, 0], other[:, 0]), 1 + 3 * COEFFICIENTS
    found = at_knots(one, times)
    found[:, 1:width] += sign * at_knots(other[:, :width], times)[:, 1:]
    return found


def _stages(formation: Any, uav: int | None) -> Array:
    """Places (1 + C, 3) of a UAV in the axes of the shape: at first and after each change; zeros for the leader."""
    place = np.array(formation.offsets_m.get(uav, (0.0, 0.0, 0.0)), dtype=np.float64)
    found = [place]
    for change in formation.changes:
        if change.offsets_m is not None:
            place = np.array(change.offsets_m.get(uav, (0.0, 0.0, 0.0)), dtype=np.float64)
        found.append(changed(change, place))
    return np.stack(found)


def _table(changes: tuple[Change, ...], stages: Array) -> Array:
    """Polynomials from stage to stage (1 + C, K): at rest, then by h of the time base, then at rest again.

    A change that begins before the last one is done goes on from where that is, by a polynomial with the same
    derivatives there.
    """
    rows = [_row(0.0, stages[0], np.zeros_like(stages[0]), 1.0)]
    for change, (before, after) in zip(changes, pairwise(stages), strict=True):
        if change.at_s < rows[-1][0]:
            rows[-1] = _moving_row(rows[-2], change, after)
        else:
            rows.append(_row(change.at_s, before, after - before, change.over_s))
        rows.append(_row(change.at_s + change.over_s, after, np.zeros_like(after), 1.0))
    return np.array(rows)


def _moving_row(last: Array, change: Change, after: Array) -> Array:
    """The row of a change that begins in the middle of row `last`."""
    row = np.zeros_like(last)
    row[0] = change.at_s
    times = np.array([change.at_s, change.at_s + change.over_s])
    for channel in range(len(after)):
        at = slice(1 + COEFFICIENTS * channel, 1 + COEFFICIENTS * (channel + 1))
        whole = np.poly1d(last[at])
        now = [whole.deriv(k)(change.at_s - last[0]) for k in range(4)]
        row[at] = hermite(times, [np.array(now), np.array([after[channel], 0.0, 0.0, 0.0])])[0]
    return row


def _row(begin: float, first: Array, step: Array, over: float) -> Array:
    channels = np.zeros((len(step), COEFFICIENTS))
    spans = np.array([over ** (7 - k) for k in range(len(_RISE))])
    channels[:, : len(_RISE)] = np.array(_RISE) * step[:, None] / spans
    channels[:, -1] = first
    return np.concatenate([[begin], channels.ravel()])


def shape_problems(file: Any) -> Iterator[str]:
    """The problems of a shape that moves."""
    formation, last = file.formation, 0.0
    if not moves(formation):
        return
    followers = [uav.id for uav in file.uavs if uav.id != file.leader.id]
    for index, change in enumerate(formation.changes):
        where = f"formation.changes[{index}]"
        if change.at_s < last:
            yield f"{where}.at_s: {change.at_s:g}: expected at least {last:g}, the end of the change before"
        last = change.at_s + change.over_s
        for uav in sorted(set(followers).symmetric_difference(change.offsets_m or followers)):
            yield f"{where}.offsets_m.{uav}: expected an offset of each follower {followers}, and of no other UAV"


def hermite(times: Array, values: Sequence[Array]) -> Array:
    """Polynomials (K - 1, 8) between K knots, the highest power first, of the time since each of them.

    Args:
        times: (K,) [s].
        values: of each knot the value and its derivatives, as many as are known, at most four.
    """
    known, spans = np.array([len(value) for value in values]), np.diff(times)
    out = np.zeros((len(spans), COEFFICIENTS))
    for before, after in set(pairwise(known.tolist())):
        at = np.flatnonzero((known[:-1] == before) & (known[1:] == after))
        rows: list[int] = at.tolist()
        size, span = before + after, spans[rows, None]
        first = np.stack([values[row] for row in rows]) * span ** np.arange(before)
        last = np.stack([values[row + 1] for row in rows]) * span ** np.arange(after)
        of_share = np.linalg.solve(conditions(before, after), np.hstack([first, last]).T).T
        out[rows, COEFFICIENTS - size :] = (of_share / span ** np.arange(size))[:, ::-1]
    return out


@cache
def conditions(before: int, after: int) -> Array:
    """Derivatives of the powers of s, the lowest first: so many at s = 0, and so many at s = 1."""
    size = before + after
    powers = [np.poly1d([1.0, *[0.0] * power]) for power in range(size)]
    ends = [(0.0, k) for k in range(before)] + [(1.0, k) for k in range(after)]
    return np.array([[power.deriv(k)(s) if k else power(s) for power in powers] for s, k in ends])


def nearest_places(starts: Array, places: Array, *, centred: bool = False) -> NDArray[np.int64]:
    """The place of each start for which the sum of the squared distances is minimal.

    The same numbers give the same answer, also where several sums are equal.

    Args:
        starts: (N, 3) [m].
        places: (N, 3) [m].
        centred: compare starts and places from the centre of each: where the places lie as a whole adds the same to
            every sum.

    Returns:
        Row of `places` (N,) for each row of `starts`.
    """
    from scipy.optimize import (
        linear_sum_assignment,  # late: half a second, and few processes decide
    )

    if centred:
        starts, places = starts - starts.mean(axis=0), places - places.mean(axis=0)
    with np.errstate(over="ignore"):
        costs = np.sum((starts[:, None] - places[None]) ** 2, axis=2)
    if not np.isfinite(costs).all():  # places beyond all measure: none is nearer than another one
        return np.arange(len(starts), dtype=np.int64)
    return np.asarray(linear_sum_assignment(costs)[1], dtype=np.int64)
