"""An obstacle: its block in a scenario file, and the bodies that sensor, verdict and check share."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from ptnsbc_core.curves.trajectory import curve_samples
from ptnsbc_core.kinematics import rotation_from_euler
from ptnsbc_core.tasks.signed_distance import (
    AXES,
    BODIES,
    BODY_COLUMNS,
    KEEP_OUT,
    KIND,
    SIZE,
    VELOCITY,
    signed_distances,
)
from ptnsbc_core.types import Array, Trajectory
from ptnsbc_sim.occupancy import COARSEST_M, FINEST_M, boxes_of
from ptnsbc_sim.scenario.fields import (
    MOST_SAMPLES,
    Block,
    Name,
    NotNegative,
    Number,
    Positive,
    PositiveVec3,
    Vec3,
)
from ptnsbc_sim.scenario.mission.trajectories import (
    TrajectoryBlock,
    trajectory_of,
    trajectory_problems,
)
from ptnsbc_sim.scenario.problems import Problem, Problems, unless

Kind = Literal["sphere", "box", "cylinder", "plane", "half_space", "ground", "map"]

_KEYS: dict[str, tuple[str, ...]] = {
    "sphere": ("position_m", "trajectory", "radius_m"),
    "box": ("position_m", "trajectory", "size_m", "rotation_rad"),
    "cylinder": ("position_m", "trajectory", "radius_m", "height_m"),
    "plane": ("position_m", "trajectory", "normal"),
    "half_space": ("position_m", "trajectory", "normal"),
    "ground": ("height_m",),
    "map": ("file", "samples", "resolution_m"),
}
_NORMAL = ("normal", "a direction of three numbers")
_NEEDED = {
    "box": ("size_m", "the length of three edges"),
    "cylinder": ("radius_m", "a radius in m"),
    "plane": _NORMAL,
    "half_space": _NORMAL,
    "ground": ("height_m", "the height of the ground in m"),
    "map": ("samples", "file: NAME and resolution_m, or the boxes"),
}
_THIN_M = 0.02  # as thick as a surface is drawn
_WITHOUT_END_M = 100.0  # as large as a plane or an endless cylinder is drawn
_OWN = tuple(dict.fromkeys(key for keys in _KEYS.values() for key in keys))


class ObstacleBlock(Block):
    """Something to keep out of."""

    name: Name
    """Name, unique among the obstacles."""
    kind: Kind = "sphere"
    """Form of the body: `sphere`; `box`; `cylinder`, upright; `plane`, thin and without end; `half_space`, solid
    behind a plane; `ground`, solid below a height; `map`, boxes that cover the points of a file."""
    position_m: Vec3 | None = None
    """Centre; of a plane and a half-space a point of the surface. Give this or `trajectory`."""
    trajectory: TrajectoryBlock | None = None
    """Trajectory of the position in place of `position_m`, with the keys of [leader.trajectory](#leader). The body does
    not turn with it."""
    keep_out_m: NotNegative
    """Least distance from the surface. A sphere without `radius_m` is a point, and this the radius to stay out of."""
    size_m: PositiveVec3 | None = None
    """*box* Length of the edges."""
    rotation_rad: Vec3 = (0.0, 0.0, 0.0)
    """*box* Roll, pitch and yaw."""
    radius_m: Positive | None = None
    """*sphere*, *cylinder* Radius of the body. Default of a sphere: 0."""
    height_m: Number | None = None
    """*cylinder* Height; default: without end. *ground* Height of the ground."""
    normal: Vec3 | None = None
    """*plane*, *half_space* Direction across the surface, of any length; out of the half-space."""
    file: str | None = None
    """*map* Name of a point cloud, looked for beside the scenario: `.pcd`, `.ply`, `.las`, `.laz`, `.npy`, `.csv` or
    `.xyz` with rows x, y, z; at most 100 MB. It becomes `samples` when it is read, so that a bag holds it."""
    resolution_m: Annotated[Positive, Field(ge=FINEST_M, le=COARSEST_M)] | None = None
    """*map* Edge of the cells of a grid: those in which a point lies are kept out of."""
    samples: Annotated[str, Field(max_length=MOST_SAMPLES)] | None = None
    """*map* The boxes, at most 400: rows x, y, z, x, y, z of two corners [m]."""


def obstacle_problems(block: ObstacleBlock) -> Problems:
    """The problems of an obstacle."""
    keys, kind = _KEYS[block.kind], block.kind
    for key in _OWN:
        given = key in block.model_fields_set and getattr(block, key) is not None
        yield from unless(
            not given or key in keys, key, f"not a key of kind {kind}", ", ".join(keys)
        )
    if kind in _NEEDED:
        needed, expected = _NEEDED[kind]
        yield from unless(getattr(block, needed) is not None, needed, "missing", expected)
    either = (block.position_m is None) != (block.trajectory is None)
    what = "missing" if block.position_m is None else "given beside trajectory"
    placed = either or kind in ("ground", "map")
    yield from unless(placed, "position_m", what, "either position_m or trajectory")
    wide = block.keep_out_m > 0.0 or kind != "sphere" or block.radius_m is not None
    yield from unless(wide, "keep_out_m", "0", "> 0, or the sphere's radius_m")
    height_m = block.height_m
    tall = kind != "cylinder" or height_m is None or height_m > 0.0
    yield from unless(tall, "height_m", height_m, "> 0")
    directed = block.normal is None or 1e-6 < math.hypot(*block.normal) < 1e6
    yield from unless(directed, "normal", "", "a direction, of a length from 1e-6 to 1e6")
    if block.samples is not None:
        try:
            boxes_of(block.samples)
        except ValueError as error:
            yield Problem("samples", str(error), "")
    if block.trajectory is not None:
        for problem in trajectory_problems(block.trajectory):
            yield problem.below("trajectory")


def bodies(block: ObstacleBlock) -> Iterator[ObstacleBlock]:
    """The blocks of the bodies of an obstacle without problems: itself, of a map its boxes, numbered from 1."""
    if block.kind != "map" or block.samples is None:
        yield block
        return
    for number, corners in enumerate(boxes_of(block.samples), 1):
        low, high = corners[:3], corners[3:]
        yield ObstacleBlock.model_construct(
            name=f"{block.name}-{number}",
            kind="box",
            position_m=tuple((0.5 * (low + high)).tolist()),
            size_m=tuple((high - low).tolist()),
            keep_out_m=block.keep_out_m,
        )


class Motion(NamedTuple):
    """The places and velocities of an obstacle at some times."""

    positions: Array  # (T, 3) [m], ENU
    velocities: Array  # (T, 3) [m/s], ENU


class Drawing(NamedTuple):
    """An obstacle as a ball, a box or an upright cylinder at the epoch."""

    size: Array  # (3,) [m] along the axes of the body
    centre: Array  # (3,) [m], ENU
    quaternion: tuple[float, float, float, float]  # x y z w, from the axes of the body to the world


class Obstacle:
    """Something to keep out of.

    Distances and `keep_out_m` are those of a sphere from its centre, of all other bodies from the surface.
    """

    def __init__(self, block: ObstacleBlock) -> None:
        self.name = block.name
        self.kind: str = block.kind
        radius_m = block.radius_m if block.kind == "sphere" else None
        self.keep_out_m = block.keep_out_m + (radius_m or 0.0)
        self._block = block

    @cached_property
    def path(self) -> Trajectory | None:
        """The trajectory of one that moves."""
        block = self._block.trajectory
        return None if block is None else trajectory_of(block)

    @cached_property
    def position(self) -> Array:
        """Position (3,) [m], ENU, at the epoch."""
        return self.motion(np.zeros(1)).positions[0]

    @cached_property
    def size(self) -> Array:
        """Size (3,) [m] as in a row of a body: half edges, or radius and half height."""
        block = self._block
        if block.size_m is not None:
            return 0.5 * np.array(block.size_m)
        if block.radius_m is not None and block.kind == "cylinder":
            height = math.inf if block.height_m is None else block.height_m
            return np.array([block.radius_m, 0.5 * height, 0.0])
        return np.zeros(3)

    @cached_property
    def axes(self) -> Array:
        """Rotation matrix (3, 3) from the axes of the body to the world; its third column is a surface's normal."""
        block = self._block
        if block.kind == "box":
            return rotation_from_euler(np.array(block.rotation_rad, dtype=np.float64))
        if block.normal is None:
            return np.eye(3)
        normal = np.array(block.normal) / math.hypot(*block.normal)
        beside = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
        beside /= np.linalg.norm(beside)
        return np.stack([beside, np.cross(normal, beside), normal], axis=1)

    def drawn(self) -> Drawing:
        """As a ball, box or cylinder to draw: of a sphere its keep-out, of all others the body."""
        from scipy.spatial.transform import Rotation  # late: half a second

        size, centre = 2.0 * self.size, self.position
        if self.kind == "sphere":
            size = np.full(3, 2.0 * self.keep_out_m)
        elif self.kind == "cylinder":
            size = np.array([size[0], size[0], min(size[1], _WITHOUT_END_M)])
        elif self.kind != "box":
            size = np.array([_WITHOUT_END_M, _WITHOUT_END_M, _THIN_M])
            centre = centre if self.kind == "plane" else centre - 0.5 * _THIN_M * self.axes[:, 2]
        x, y, z, w = Rotation.from_matrix(self.axes).as_quat()
        return Drawing(size, centre, (float(x), float(y), float(z), float(w)))

    def motion(self, times: Array) -> Motion:
        """Positions and velocities at times (T,) [s] since the first epoch; before it the obstacle stands still."""
        block, still = self._block, np.zeros((len(times), 3))
        if self.path is None:
            place = block.position_m if block.kind != "ground" else (0.0, 0.0, block.height_m)
            return Motion(np.tile(np.array(place, dtype=np.float64), (len(times), 1)), still)
        at = curve_samples(self.path, np.maximum(times, 0.0))
        velocities = np.where((times >= 0.0)[:, None], at[:, 3:6], 0.0)
        return Motion(at[:, 0:3], velocities)

    def rows(self, times: Array) -> Array:
        """The body as rows (T, 20), see ptnsbc_core.tasks.signed_distance."""
        rows, at = np.zeros((len(times), BODY_COLUMNS)), self.motion(times)
        rows[:, 0:3], rows[:, VELOCITY : VELOCITY + 3] = at
        rows[:, KEEP_OUT] = self.keep_out_m
        rows[:, KIND] = BODIES["half_space" if self.kind == "ground" else self.kind]
        rows[:, SIZE : SIZE + 3] = self.size
        rows[:, AXES : AXES + 9] = self.axes.ravel()
        return rows

    def distances(self, places: Array, times: Array) -> Array:
        """Distances (T,) [m] of places (T, 3) at times (T,) [s] since the first epoch."""
        if self.path is None:
            return signed_distances(np.ascontiguousarray(places), self.rows(np.zeros(1))[0])
        beside = places - self.motion(times).positions
        row = self.rows(np.zeros(1))[0]
        row[0:3] = 0.0
        return signed_distances(np.ascontiguousarray(beside), row)
