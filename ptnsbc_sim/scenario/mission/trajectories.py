"""Trajectories of the leader as blocks of a scenario file. The curves that the laws follow are made in `curves`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import Field

from ptnsbc_core.types import Trajectory
from ptnsbc_sim.scenario.fields import Block, Flag, NotNegative, Number, Vec3
from ptnsbc_sim.scenario.mission.stream import SetpointTrajectory
from ptnsbc_sim.scenario.reading.named_files import MOST_SAMPLES

MOST_POINTS = 2000
"""Points of a curve at most, also rows of a CSV file."""

HeadingWord = Literal["fixed", "path"]
Points = Annotated[tuple[Vec3, ...], Field(min_length=2, max_length=MOST_POINTS)]


class Circle(Block):
    """Centre + radius (sin, cos)(rate t + phase): clockwise from north, as in the paper."""

    kind: Literal["circle"]
    """Position centre + radius (sin, cos)(rate t + phase): clockwise from north."""
    centre_m: Vec3
    """Centre; its z is the height."""
    radius_m: NotNegative
    """Radius of the circle."""
    rate_rad_s: Number
    """Angular rate."""
    phase_rad: Number = 0.0
    """Angle at t = 0."""
    yaw_rad: Number = 0.0
    """Heading to hold."""
    heading: HeadingWord = "fixed"
    """`fixed` holds `yaw_rad`, `path` turns with the path."""


class Line(Block):
    """position + velocity t."""

    kind: Literal["line"]
    """Position + velocity t."""
    position_m: Vec3
    """Position at the epoch."""
    velocity_m_s: Vec3 = (0.0, 0.0, 0.0)
    """Constant velocity."""
    yaw_rad: Number = 0.0
    """Heading to hold."""


class Hover(Block):
    """A place to stay at."""

    kind: Literal["hover"]
    """Position to stay at."""
    position_m: Vec3
    """Position."""
    yaw_rad: Number = 0.0
    """Heading to hold."""


class Lissajous(Block):
    """One sine for each axis."""

    kind: Literal["lissajous"]
    """Position centre + amplitude sin(rate t + phase), each axis with numbers of its own."""
    centre_m: Vec3
    """Centre."""
    amplitude_m: Vec3
    """Amplitude of each axis."""
    rate_rad_s: Vec3
    """Angular rate of each axis; a figure of eight has [w, 2 w, 0]."""
    phase_rad: Vec3 = (0.0, 0.0, 0.0)
    """Angle of each axis at t = 0."""
    yaw_rad: Number = 0.0
    """Heading to hold."""
    heading: HeadingWord = "fixed"
    """`fixed` holds `yaw_rad`, `path` turns with the path."""


class Waypoints(Block):
    """A curve through points."""

    kind: Literal["waypoints"]
    """Curve through points, which stays at the last of them."""
    points_m: Points
    """The points, 2 to 2000."""
    times_s: tuple[NotNegative, ...] | None = None
    """Time of each point, from 0; of a closed curve also the time at which it is back at the first one. Give this or
    `speed_m_s`."""
    speed_m_s: Annotated[Number, Field(ge=1e-3, le=1e3)] | None = None
    """Mean speed from point to point along the straight line between them; of `straight` the largest one."""
    through: Literal["straight", "cubic", "minimum_snap"] = "minimum_snap"
    """`straight` goes in straight lines and rests at each point; `cubic` is a spline with continuous acceleration;
    `minimum_snap` has the least integral of the squared fourth derivative. All begin and end at rest, unless closed."""
    closed: Flag = False
    """True if the curve goes back to the first point and repeats."""
    yaws_rad: tuple[Number, ...] | None = None
    """Heading at each point; between them it turns the shorter way. Default: `heading` decides."""
    yaw_rad: Number = 0.0
    """Heading to hold."""
    heading: HeadingWord = "fixed"
    """`fixed` holds `yaw_rad`, `path` turns with the path."""


class Csv(Block):
    """A curve through the rows of a CSV file."""

    kind: Literal["csv"]
    """Cubic spline through the rows t, x, y, z, yaw of a CSV file, which stays at the last of them."""
    file: str | None = None
    """Name of the file, looked for beside the scenario; at most 2000 rows and 200 000 characters. It becomes `samples`
    when it is read, so that a bag holds it."""
    samples: Annotated[str, Field(max_length=MOST_SAMPLES)] | None = None
    """The content of such a file: rows t [s] from 0, x, y, z [m], yaw [rad]; a first row of names is left out."""
    yaw_rad: Number = 0.0
    """Heading to hold where the rows have no fifth column."""
    heading: HeadingWord = "fixed"
    """Without a fifth column: `fixed` holds `yaw_rad`, `path` turns with the path."""


TrajectoryBlock = Annotated[
    Circle | Line | Hover | Lissajous | Waypoints | Csv, Field(discriminator="kind")
]
LeaderTrajectoryBlock = Annotated[
    Circle | Line | Hover | Lissajous | Waypoints | Csv | SetpointTrajectory,
    Field(discriminator="kind"),
]


@dataclass(frozen=True)
class Route:
    """The path of the leader through the legs of a mission, in the place of a trajectory block."""

    first: Any  # the trajectory block that it begins with
    legs: tuple[Any, ...]  # those that move the leader, with their times
    until_s: float  # the curve ends there
    curve: Trajectory = field(compare=False)
    apart: tuple[Any, ...] = field(
        default=(), compare=False
    )  # the groups that leave it for a while
