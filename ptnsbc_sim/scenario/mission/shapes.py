"""The shape of a formation: its blocks in a scenario file, a library of shapes, and who takes which place."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from ptnsbc_core.types import Array
from ptnsbc_io.number_table import read_table
from ptnsbc_sim.scenario.fields import MOST_SAMPLES, Block, Number, UavId, Vec3, three

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
    """*file* The content of such a file [m], or names and units of the columns in the first row."""


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


def _arms(size: int, spacing: float, ahead: float, aside: float) -> Array:
    """Two arms from the leader, left and right of it in turn: a wedge, or a line side by side."""
    rows = np.array([(uav + 1) // 2 for uav in range(size)], dtype=np.float64)
    sides = np.array([aside if uav % 2 else -aside for uav in range(size)])
    return spacing * np.stack([ahead * rows, sides * rows, 0.0 * rows], axis=1)


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
    "v": partial(_arms, ahead=-0.8, aside=0.6),
    "line": partial(_arms, ahead=0.0, aside=1.0),
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
    if block.kind != "file":
        if block.spacing_m is None:
            raise ValueError("spacing_m: missing: expected a number in m")
        return SHAPES[block.kind](size, block.spacing_m)
    if block.samples is None:
        raise ValueError("file: missing: expected the name of a CSV file, or samples")
    try:
        places = offsets_of(block.samples)
    except ValueError as error:
        raise ValueError(f"samples: {error}") from None
    if len(places) != size - 1:
        raise ValueError(
            f"samples: {len(places)} places: expected {size - 1}, one for each follower"
        )
    return np.concatenate([np.zeros((1, 3)), places])


def offsets_of(text: str) -> Array:
    """The rows x, y, z [m] of a table of places.

    Raises:
        ValueError: a row that is none, in words that follow a key.
    """
    places = read_table(text, ("x", "y", "z"))
    if np.abs(places).max(initial=0.0) > 1e6:
        raise ValueError("expected no number beyond 1e6 m")
    return places


def changed(change: Reshaping, place: Array) -> Array:
    """A place (..., 3) scaled and sheared by a change."""
    return np.array(change.scale) * place + change.shear * place[..., 1:2] * np.eye(3)[0]


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
    from scipy.optimize import linear_sum_assignment  # late: half a second, and few decide

    if centred:
        starts, places = starts - starts.mean(axis=0), places - places.mean(axis=0)
    with np.errstate(over="ignore"):
        costs = np.sum((starts[:, None] - places[None]) ** 2, axis=2)
    if not np.isfinite(costs).all():  # places beyond all measure: none is nearer than another one
        return np.arange(len(starts), dtype=np.int64)
    return np.asarray(linear_sum_assignment(costs)[1], dtype=np.int64)
