"""A map from a file as boxes: the cells of a grid in which a point lies, joined to cuboids.

The near-object sensor, the verdict and all pictures know boxes: docs/notes/bodies.md.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array
from ptnsbc_io.number_table import read_table
from ptnsbc_io.point_cloud_file import PointCloudFileError, read_points

MOST_BOXES = 400
"""Of one map: each costs the near-object sensor a distance at every reading."""

FINEST_M, COARSEST_M = 0.01, 100.0
"""Bounds of the edge of a cell."""

_MOST_CELLS = 200_000


def map_text(suffix: str, data: bytes, resolution_m: float) -> str:
    """The boxes of a map file as text, a row of the two corners x, y, z [m] for each.

    `suffix` and `data` are those of `point_cloud_file.read_points`, `resolution_m` the edge of a cell.

    Raises:
        PointCloudFileError: the file is no point cloud, or takes too many boxes.
    """
    corners = covering_boxes(read_points(suffix, data), resolution_m)
    return "".join(",".join(f"{number:.10g}" for number in row) + "\n" for row in corners.tolist())


def covering_boxes(points: Array, resolution_m: float) -> Array:
    """Boxes (B, 6) [m], lower and upper corner, which together are the occupied cells of a grid.

    Args:
        points: (N, 3) [m].
        resolution_m: edge of a cell; a corner of one is at the origin.
    """
    cells = np.unique(np.floor(points / resolution_m).astype(np.int64), axis=0)
    if len(cells) > _MOST_CELLS:
        raise PointCloudFileError(
            f"{len(cells)} occupied cells: expected at most {_MOST_CELLS}, raise resolution_m"
        )
    boxes = list(_cuboids(cells))
    if len(boxes) > MOST_BOXES:
        raise PointCloudFileError(
            f"{len(boxes)} boxes: expected at most {MOST_BOXES}, raise resolution_m"
        )
    return np.array(boxes, dtype=np.float64) * resolution_m


def _cuboids(cells: NDArray[np.int64]) -> Iterator[list[int]]:
    """Cuboids of cells (C, 3): each begins with the first cell that is left, and grows along z, y and x in turn."""
    left = dict.fromkeys(map(tuple, cells.tolist()))
    for first in list(left):
        if first not in left:
            continue
        low, high = list(first), [at + 1 for at in first]
        for axis in (2, 1, 0):
            while (layer := _layer(low, high, axis)) and all(cell in left for cell in layer):
                high[axis] += 1
        for cell in _inside(low, high):
            del left[cell]
        yield [*low, *high]


def _layer(low: list[int], high: list[int], axis: int) -> list[tuple[int, ...]]:
    """The cells that follow a cuboid along an axis."""
    beyond_low, beyond_high = list(low), list(high)
    beyond_low[axis], beyond_high[axis] = high[axis], high[axis] + 1
    return _inside(beyond_low, beyond_high)


def _inside(low: list[int], high: list[int]) -> list[tuple[int, ...]]:
    spans = [range(a, b) for a, b in zip(low, high, strict=True)]
    return [(x, y, z) for x in spans[0] for y in spans[1] for z in spans[2]]


def boxes_of(text: str) -> Array:
    """Boxes (B, 6) [m] of the text of a map.

    Raises:
        ValueError: the text is none, in words that follow `samples:`.
    """
    corners = read_table(text, (*"xyz", *"xyz"))
    if not 0 < len(corners) <= MOST_BOXES:
        raise ValueError(f"{len(corners)} boxes: expected 1 to {MOST_BOXES}, two corners in a row")
    if not (corners[:, :3] < corners[:, 3:]).all() or np.abs(corners).max() > 2e6:
        raise ValueError("expected boxes whose second corner is above the first, up to 2e6 m")
    return corners
