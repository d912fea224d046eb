"""Trajectories of the leader: their blocks in a scenario file, their curves, extremes, and why a block has none.

SciPy's splines make curves through points once; they become a table of polynomials (`ptnsbc_core.curves.trajectory`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from pydantic import Field

from ptnsbc_core.curves.trajectory import COEFFICIENTS, curve_samples
from ptnsbc_core.types import (
    HEADING_FIXED,
    HEADING_PATH,
    HEADING_TABLE,
    TRAJECTORY_CIRCLE,
    TRAJECTORY_HARMONIC,
    TRAJECTORY_LINE,
    TRAJECTORY_PIECEWISE,
    Array,
    Trajectory,
)
from ptnsbc_sim.scenario.fields import MOST_SAMPLES, Block, Flag, NotNegative, Number, Vec3
from ptnsbc_sim.scenario.mission.path_files import path_rows
from ptnsbc_sim.scenario.mission.pieces import CHANNELS, WIDTH, curve_by, curve_of
from ptnsbc_sim.scenario.mission.stream import (
    SetpointTrajectory,
    Streamed,
    setpoints_of,
    stream_problems,
    streamed,
)
from ptnsbc_sim.scenario.problems import Problem, Problems, unless

MOST_POINTS = 2000
"""Points of a curve at most, also rows of a file."""

HeadingWord = Literal["fixed", "path"]
Pace = Annotated[Number, Field(ge=1e-3, le=1e3)]
Points = Annotated[tuple[Vec3, ...], Field(min_length=2, max_length=MOST_POINTS)]


class Circle(Block):
    """Position centre + radius (sin, cos)(rate t + phase): clockwise from north."""

    kind: Literal["circle"]
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
    """Position + velocity t."""

    kind: Literal["line"]
    position_m: Vec3
    """Position at the epoch."""
    velocity_m_s: Vec3 = (0.0, 0.0, 0.0)
    """Constant velocity."""
    yaw_rad: Number = 0.0
    """Heading to hold."""


class Hover(Block):
    """Position to stay at."""

    kind: Literal["hover"]
    position_m: Vec3
    """Position."""
    yaw_rad: Number = 0.0
    """Heading to hold."""


class Lissajous(Block):
    """Position centre + amplitude sin(rate t + phase), each axis with numbers of its own."""

    kind: Literal["lissajous"]
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
    """Curve through points, which stays at the last of them."""

    kind: Literal["waypoints"]
    points_m: Points
    """The points, 2 to 2000."""
    times_s: tuple[NotNegative, ...] | None = None
    """Time of each point, from 0; of a closed curve also the time at which it is back at the first one. Give this or
    `speed_m_s`."""
    speed_m_s: Pace | None = None
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


class PathFile(Block):
    """Path from a file, which stays at its end: a cubic spline through rows with times, `minimum_snap` through
    waypoints, polynomials as they are.
    """

    kind: Literal["file", "csv"]
    """`csv` is the same."""
    file: str | None = None
    """Name of the file, looked for beside the scenario; at most 2000 rows and 200 000 characters. It becomes `samples`
    when it is read, so that a bag holds it."""
    samples: Annotated[str, Field(max_length=MOST_SAMPLES)] | None = None
    """The content of such a file: rows t [s] from 0, x, y, z [m], yaw [rad], or another form of
    [bring_your_own.md](bring_your_own.md#trajectories)."""
    speed_m_s: Pace | None = None
    """Mean speed from point to point, of rows without times."""
    rate_hz: Pace | None = None
    """Rate of rows without times, in the place of `speed_m_s`."""
    drone: Annotated[int, Field(ge=1)] | None = None
    """Number of the drone in a show, from 1. Default: the first."""
    yaw_rad: Number = 0.0
    """Heading to hold where the file has none."""
    heading: HeadingWord = "fixed"
    """Of a file without headings: `fixed` holds `yaw_rad`, `path` turns with the path."""


TrajectoryBlock = Annotated[
    Circle | Line | Hover | Lissajous | Waypoints | PathFile, Field(discriminator="kind")
]
LeaderTrajectoryBlock = Annotated[
    Circle | Line | Hover | Lissajous | Waypoints | PathFile | SetpointTrajectory,
    Field(discriminator="kind"),
]


class Apart(NamedTuple):
    """A group that leaves the formation for a while."""

    head: int  # it and all UAVs below it in the tree are the group
    begin_s: float  # when it leaves [s]
    rows: Array  # (K, 25) by what its places are displaced, three channels


@dataclass(frozen=True)
class Route:
    """The path of the leader through the legs of a mission, in the place of a trajectory block."""

    first: AnyPath  # the trajectory block that it begins with
    legs: tuple[Any, ...]  # those that move the leader, with their times
    until_s: float  # the curve ends there
    curve: Trajectory = field(compare=False)
    apart: tuple[Apart, ...] = field(default=(), compare=False)


AnyPath: TypeAlias = (
    Circle | Line | Hover | Lissajous | Waypoints | PathFile | SetpointTrajectory | Route | Streamed
)
"""A trajectory block, or the path that a leader has instead of one."""

_TOP_RATE = 2.1875  # largest h_dot of h = 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7
_LEAST_GAP_S = 0.01
_STILL_M, _GAP_M = 1e-6, 0.05  # points of one place; rounded coefficients leave millimetres
_FARTHEST = 1e6  # [m], [s] and [rad] of what a curve goes through
_STEP_S = 0.01  # between two samples of `extremes`, at most
_MOST_STEPS = 50_000
_BEFORE_S = 1e-9  # before the end of a piece


def trajectory_problems(block: AnyPath) -> Problems:
    """The errors of a trajectory; only the first one counts, others may follow from it."""
    if isinstance(block, SetpointTrajectory):
        yield from stream_problems(block)
    if isinstance(block, Waypoints):
        yield from _waypoint_problems(block)
    elif isinstance(block, PathFile):
        try:
            samples_of(block.samples, block.speed_m_s, block.rate_hz)
        except ValueError as error:
            yield Problem("samples", str(error), "")
            return
    if isinstance(block, Waypoints | PathFile):
        try:
            with np.errstate(all="ignore"):
                finite = bool(np.isfinite(trajectory_of(block).table).all())
        except ValueError:  # of SciPy; LinAlgError is one
            finite = False
        key = "samples" if isinstance(block, PathFile) else "times_s"
        value = "no smooth curve goes through these points"
        yield from unless(finite, key, value, "times that are more even")


def _too_far(numbers: Any) -> bool:
    return bool(np.abs(np.array(numbers, dtype=np.float64)).max(initial=0.0) > _FARTHEST)


def _waypoint_problems(block: Waypoints) -> Problems:
    size, times, yaws = len(block.points_m), block.times_s, block.yaws_rad
    for key in ("points_m", "times_s", "yaws_rad"):
        near = not _too_far(getattr(block, key) or ())
        yield from unless(near, key, "", f"no number beyond {_FARTHEST:g}")
    one = (times is None) != (block.speed_m_s is None)
    yield from unless(one, "times_s", "", "either times_s or speed_m_s")
    if yaws is not None:
        value, expected = f"{len(yaws)} numbers", f"one for each of {size} points"
        yield from unless(len(yaws) == size, "yaws_rad", value, expected)
    if times is None:
        for k, (point, other) in enumerate(pairwise(_lap(block))):
            apart = np.linalg.norm(other - point) >= _STILL_M
            expected = "another point, or times_s"
            yield from unless(apart, f"points_m[{k}]", "the same as the next one", expected)
        return
    needed = size + block.closed
    why = f"each of {size} points" + (" and the end of the lap" if block.closed else "")
    value, expected = f"{len(times)} numbers", f"{needed}, one for {why}"
    yield from unless(len(times) == needed, "times_s", value, expected)
    if (wrong := _not_ascending(times)) is not None:
        yield Problem(f"times_s[{wrong}]", f"{times[wrong]:g}", _ASCENDING)


_ASCENDING = f"times that begin with 0 and ascend, by {_LEAST_GAP_S:g} s or more"


def _not_ascending(times: Sequence[float]) -> int | None:
    """Index of the first time that is not 0 at the start or not after the one before; None: all are well."""
    if times[0] != 0.0:
        return 0
    late = [k for k, (a, b) in enumerate(pairwise(times), 1) if b - a < _LEAST_GAP_S - 1e-9]
    return late[0] if late else None


@lru_cache(maxsize=4)
def samples_of(
    text: str | None, speed_m_s: float | None = None, rate_hz: float | None = None
) -> Array:
    """The rows of the content of a file, as `path_files.path_rows` gives them.

    Raises:
        ValueError: a row that is none, in words that follow a key.
    """
    if text is None:
        raise ValueError("missing: expected file: NAME, or samples: with its content")
    if speed_m_s is not None and rate_hz is not None:
        raise ValueError("expected either speed_m_s or rate_hz")
    table = path_rows(text, untimed=speed_m_s is not None, rate_hz=rate_hz)
    if not 2 - _are_polynomials(table) <= len(table) <= MOST_POINTS:
        raise ValueError(
            f"{len(table)} rows: expected 2 to {MOST_POINTS}, {_LEAST_GAP_S:g} s apart or more"
        )
    if _too_far(table):
        raise ValueError(f"expected no number beyond {_FARTHEST:g}")
    if _are_polynomials(table):
        _refuse_gaps(table)
        return table
    if speed_m_s is not None:
        still = np.flatnonzero(np.linalg.norm(np.diff(table[:, :3], axis=0), axis=1) < _STILL_M)
        if len(still):
            raise ValueError(f"row {still[0] + 2} of numbers: expected another point than before")
        return table
    wrong = _not_ascending(table[:, 0].tolist())
    if wrong is not None:
        raise ValueError(
            f"row {wrong + 1} of numbers, t = {table[wrong, 0]:g}: expected {_ASCENDING}; speed_m_s "
            "or rate_hz of rows without times"
        )
    return table


def _are_polynomials(table: Array) -> bool:
    return table.shape[1] > COEFFICIENTS


def _refuse_gaps(table: Array) -> None:
    """ValueError where a piece is short, or begins away from the end of the one before."""
    powers = table[:, 1:].reshape(len(table), -1, COEFFICIENTS)
    ends = (powers * (table[:, :1] ** np.arange(COEFFICIENTS))[:, None]).sum(axis=2)
    gaps = np.abs(ends[:-1] - powers[1:, :, 0])[:, :3].max(axis=1)
    if (table[:, 0] < _LEAST_GAP_S).any():
        raise ValueError(f"expected pieces of {_LEAST_GAP_S:g} s or more")
    if wide := np.flatnonzero(gaps > _GAP_M).tolist():
        row, gap = wide[0] + 2, gaps[wide[0]]
        raise ValueError(
            f"row {row} of numbers: begins {gap:.3g} m from the end of the one before: expected a path without gaps"
        )


def trajectory_of(block: AnyPath) -> Trajectory:
    """The curve of a trajectory block that has no `problems`."""
    return block.curve if isinstance(block, Route | Streamed) else _curve_of(block)


def first_place(block: AnyPath) -> tuple[float, ...]:
    """The begin of a trajectory, or the centre that it goes around [m], ENU."""
    numbers, table = trajectory_of(block)
    if not len(table):
        return numbers[1:4]
    if numbers[0] == TRAJECTORY_HARMONIC:
        return tuple(table[:, 0].tolist())
    return tuple(table[0, COEFFICIENTS : 3 * COEFFICIENTS + 1 : COEFFICIENTS].tolist())


@lru_cache(maxsize=64)
def _curve_of(block: TrajectoryBlock | SetpointTrajectory) -> Trajectory:
    if isinstance(block, SetpointTrajectory):
        return streamed(block, setpoints_of(block.samples or "")).curve
    if isinstance(block, Circle):
        if block.heading == "path":
            return _harmonic(block)
        motion = (block.radius_m, block.rate_rad_s, block.phase_rad)
        return curve_by(TRAJECTORY_CIRCLE, *block.centre_m, *motion, block.yaw_rad)
    if isinstance(block, Line):
        return curve_by(TRAJECTORY_LINE, *block.position_m, *block.velocity_m_s, block.yaw_rad)
    if isinstance(block, Hover):
        return curve_by(TRAJECTORY_LINE, *block.position_m, 0.0, 0.0, 0.0, block.yaw_rad)
    if isinstance(block, Lissajous):
        return _harmonic(block)
    return _of_file(block) if isinstance(block, PathFile) else _through_points(block)


def _of_file(block: PathFile) -> Trajectory:
    table = samples_of(block.samples, block.speed_m_s, block.rate_hz)
    if block.speed_m_s is not None:
        points, yaws = table[:, :3].tolist(), table[:, 3].tolist() if table.shape[1] > 3 else None
        given = {"speed_m_s": block.speed_m_s, "yaw_rad": block.yaw_rad, "heading": block.heading}
        return _through_points(Waypoints(kind="waypoints", points_m=points, yaws_rad=yaws, **given))
    if _are_polynomials(table):
        times = np.concatenate([[0.0], np.cumsum(table[:, 0])])
        powers = table[:, 1:].reshape(len(table), -1, COEFFICIENTS)[:, :, ::-1]
        pieces = list(powers.transpose(1, 0, 2))
    else:
        times = table[:, 0]
        columns = [*table.T[1:4], *map(np.unwrap, table.T[4:])]
        pieces = [_pieces(times, column, "cubic_free", False) for column in columns]
    if len(pieces) == CHANNELS:
        return _piecewise(times, pieces, HEADING_TABLE, 0.0, block.yaw_rad)
    pieces.append(np.zeros_like(pieces[0]))
    return _piecewise(times, pieces, _heading_of(block), 0.0, block.yaw_rad)


def _heading_of(block: Circle | Lissajous | Waypoints | PathFile) -> int:
    return HEADING_PATH if block.heading == "path" else HEADING_FIXED


def _harmonic(block: Circle | Lissajous) -> Trajectory:
    """A sine for each axis; that of the circle's second axis is a quarter of a turn ahead."""
    if isinstance(block, Circle):
        size, rate, phase = block.radius_m, block.rate_rad_s, block.phase_rad
        rows = ((size, size, 0.0), (rate, rate, 0.0), (phase, phase + np.pi / 2, 0.0))
    else:
        rows = (block.amplitude_m, block.rate_rad_s, block.phase_rad)
    table = np.ascontiguousarray(np.array((block.centre_m, *rows), dtype=np.float64).T)
    heading = _heading_of(block)
    return curve_by(TRAJECTORY_HARMONIC, heading, 0, 0, 0, 0, 0, block.yaw_rad, table=table)


def _lap(block: Waypoints) -> Array:
    """The points in turn; of a closed curve the first one again."""
    points = np.array(block.points_m, dtype=np.float64)
    return np.concatenate([points, points[:1]]) if block.closed else points


def _through_points(block: Waypoints) -> Trajectory:
    points, yaws = _lap(block), None
    if block.times_s is not None:
        times = np.array(block.times_s, dtype=np.float64)
    else:
        assert block.speed_m_s is not None  # or it has a problem
        slow = _TOP_RATE if block.through == "straight" else 1.0
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        times = np.concatenate([[0.0], np.cumsum(slow * lengths / block.speed_m_s)])
    if block.yaws_rad is not None:
        yaws = np.unwrap(np.array([*block.yaws_rad, *block.yaws_rad[:1]][: len(points)]))
    turns = np.zeros(len(points)) if yaws is None else yaws
    values = np.concatenate([points, turns[:, None]], axis=1)
    way = "cubic_periodic" if block.through == "cubic" and block.closed else block.through
    # A heading that has turned round as a whole is no periodic function: it goes by rests from point to point.
    pieces = [_pieces(times, column, way, block.closed) for column in values.T[:3]]
    pieces.append(_pieces(times, turns, "straight", block.closed))
    heading = HEADING_TABLE if yaws is not None else _heading_of(block)
    period = float(times[-1]) if block.closed else 0.0
    return _piecewise(times, pieces, heading, period, block.yaw_rad)


def _pieces(times: Array, values: Array, way: str, closed: bool) -> Array:
    """Coefficients (S - 1, 8) between S values, the highest power first, of the time since each of them."""
    from scipy.interpolate import CubicSpline, PPoly, make_interp_spline  # late: half a second

    out = np.zeros((len(times) - 1, COEFFICIENTS))
    if way == "straight":
        spans, steps = np.diff(times), np.diff(values)
        for k, factor in enumerate((-20.0, 70.0, -84.0, 35.0)):
            out[:, k] = factor * steps / spans ** (7 - k)
        out[:, -1] = values[:-1]
        return out
    if way == "minimum_snap":
        rest = [(order, 0.0) for order in (1, 2, 3)]
        ends = "periodic" if closed else (rest, rest)
        spline = PPoly.from_spline(make_interp_spline(times, values, k=7, bc_type=ends))
        rows = np.searchsorted(spline.x, times[:-1] + 1e-9, side="right") - 1
        return np.ascontiguousarray(spline.c[:, rows].T)
    ends = {"cubic": "clamped", "cubic_periodic": "periodic", "cubic_free": "not-a-knot"}[way]
    out[:, -4:] = CubicSpline(times, values, bc_type=ends).c.T
    return out


def _piecewise(
    times: Array, pieces: Sequence[Array], heading: int, period: float, yaw: float
) -> Trajectory:
    """The curve of the pieces of each channel, which stays at its end."""
    table = np.zeros((len(times), WIDTH))
    table[:, 0] = times
    for channel, piece in enumerate(pieces):
        first = 1 + COEFFICIENTS * channel
        table[:-1, first : first + COEFFICIENTS] = piece
        table[-1, first + COEFFICIENTS - 1] = np.polyval(piece[-1], times[-1] - times[-2])
    return curve_of(table, heading, period, yaw)


class Extremes(NamedTuple):
    """The speeds and places of a trajectory during a flight, at instants 10 ms apart or less."""

    speed_m_s: float
    acceleration_m_s2: float
    jerk_m_s3: float
    turn_rad_s: float  # largest rate of the heading
    slowest_m_s: float  # least horizontal speed
    jump_m_s: float  # largest change of the velocity where one piece ends and the next begins


@lru_cache(maxsize=64)
def extremes(block: AnyPath, duration_s: float) -> Extremes:
    """The extremes over the first `duration_s` of a flight; of a stream what its limits allow."""
    if isinstance(block, SetpointTrajectory | Streamed):
        most = block.block if isinstance(block, Streamed) else block
        speed, acceleration = most.speed_m_s, most.acceleration_m_s2
        return Extremes(speed, acceleration, most.jerk_m_s3, most.turn_rad_s, 0.0, 0.0)
    curve = trajectory_of(block)
    ends = curve.table[:, 0] if curve.numbers[0] == TRAJECTORY_PIECEWISE else np.zeros(0)
    last = max(duration_s, 0.0)
    if isinstance(block, (Circle, Lissajous)):
        # Nothing new comes later, or as good as nothing where the rates have no common period.
        rates = block.rate_rad_s if isinstance(block, Lissajous) else (block.rate_rad_s,)
        slowest = min((abs(rate) for rate in rates if rate != 0.0), default=np.inf)
        last = min(last, 20.0 * np.pi / slowest)
    elif isinstance(block, (Line, Hover)):
        last = 0.0
    else:
        last = min(last, float(ends[-1]))
    steps = min(max(round(last / _STEP_S), 1), _MOST_STEPS)
    inside = ends[(ends > 0.0) & (ends <= last)]
    times = np.concatenate([np.linspace(0.0, last, steps + 1), inside, inside - _BEFORE_S])
    at = curve_samples(curve, times)
    velocity = at[:, 3:6]
    jumps = velocity[steps + 1 : steps + 1 + len(inside)] - velocity[steps + 1 + len(inside) :]
    return Extremes(
        longest(velocity),
        longest(at[:, 6:9]),
        longest(at[:, 9:12]),
        float(np.abs(at[:, 13]).max()),
        float(np.hypot(velocity[:, 0], velocity[:, 1]).min()),
        longest(jumps) if len(jumps) else 0.0,
    )


def longest(vectors: Array) -> float:
    """Norm of the longest of vectors (N, 3)."""
    return float(np.linalg.norm(vectors, axis=1).max())
