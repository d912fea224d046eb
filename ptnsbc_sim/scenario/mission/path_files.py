"""Files of a path, known by their content: tables, polynomials, a show of Skybrush, a plan of QGroundControl.

What is a table stays one. A show becomes a table of polynomials, a plan one of waypoints.
"""

from __future__ import annotations

from io import BytesIO
from itertools import pairwise
from typing import Annotated, Any, Literal
from zipfile import ZipFile

import numpy as np
from pydantic import AliasPath, BaseModel, Field, FiniteFloat, ValidationError

from ptnsbc_core.curves.trajectory import COEFFICIENTS
from ptnsbc_core.kinematics import yaw_of
from ptnsbc_core.types import Array
from ptnsbc_io.number_table import COEFFICIENT_NAMES, head_of, read_table

FORMS = (
    "rows t, x, y, z, yaw; rows x, y, z, yaw with speed_m_s or rate_hz; poses of TUM; polynomials of uav_trajectories; "
    "a .skyc of Skybrush; a .plan of QGroundControl"
)
HOME = "plan_home"
"""The key of the home of a plan, until the scenario is whole."""

_POSES = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
_MOST_BYTES = 20_000_000  # of a file in a show
_WAYPOINT, _TAKEOFF = 16, 22
_ABOVE_HOME, _ABOVE_SEA = (3, 6), (0, 5)  # frames
_OTHERS = {17: "loiter", 18: "loiter", 19: "loiter", 20: "return", 21: "land", 178: "speed"}

_Place = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
_Point = tuple[FiniteFloat, _Place, Annotated[list[_Place], Field(max_length=6)]]


class _Item(BaseModel):
    complexItemType: str = ""
    command: int = 0
    frame: int = -1
    params: list[float | None] = []


class _Plan(BaseModel):
    fileType: Literal["Plan"]
    speed: FiniteFloat = Field(validation_alias=AliasPath("mission", "hoverSpeed"))
    home: _Place = Field(validation_alias=AliasPath("mission", "plannedHomePosition"))
    items: list[_Item] = Field(min_length=2, validation_alias=AliasPath("mission", "items"))


class _Path(BaseModel):
    elsewhere: str = Field("", alias="$ref")
    points: list[_Point] = []


class _Drone(BaseModel):
    path: _Path = Field(validation_alias=AliasPath("settings", "trajectory"))


class _Show(BaseModel):
    drones: list[_Drone] = Field(validation_alias=AliasPath("swarm", "drones"))


def text_of(data: bytes, drone: object = None) -> str:
    """The table in a file, or the text of a plan; `drone` counts those of a show from 1, None is the first.

    Raises:
        ValueError: the file is none that is known, in words that follow its name.
    """
    if data.startswith(b"PK"):
        return _show_text(data, 1 if drone is None else drone)
    if drone is not None:
        raise ValueError("drone: expected no number, only a .skyc of Skybrush has several")
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start} is no text: expected {FORMS}") from None


def path_rows(text: str, *, untimed: bool = False, rate_hz: float | None = None) -> Array:
    """The rows of a table in s, m and rad: t, x, y, z; of waypoints x, y, z; of both a yaw if they have one.

    Polynomials have a duration and the coefficients of 3 or 4 axes, the lowest power first. `untimed` rows are
    waypoints, and those of a `rate_hz` get times.

    Raises:
        ValueError: a row that does not fit, or none that is known, in words that follow a key.
    """
    width, words = head_of(text)
    pieces = width in (25, 33) and (not words or "duration" in words)
    poses = words.issuperset(_POSES[4:]) or (not words and width == len(_POSES))
    timed = pieces or poses or not words.isdisjoint(("t", "time", "timestamp"))
    untimed |= rate_hz is not None
    if timed and untimed:
        raise ValueError("these rows have times: expected neither speed_m_s nor rate_hz")
    if not (timed or untimed) and (width == 3 or "x" in words):
        raise ValueError("these rows have no times: expected speed_m_s, or rate_hz of samples")
    if width > 5 and not words and not timed:
        raise ValueError(f"{width} columns without names: expected {FORMS}")
    if pieces:
        return read_table(text, ("duration", *COEFFICIENT_NAMES)[:width])
    if poses:
        rows = read_table(text, _POSES)
        if not np.allclose(np.hypot.reduce(rows[:, 4:].clip(-2.0, 2.0), axis=1), 1.0, atol=0.01):
            raise ValueError("expected quaternions qx, qy, qz, qw of length 1")
        yaws = [yaw_of(row[1:]) for row in rows]
        return np.column_stack([rows[:, 0] - rows[:1, 0], rows[:, 1:4], yaws])
    rows = read_table(
        text, ("x", "y", "z", "yaw") if untimed else ("t", "x", "y", "z", "yaw"), optional=1
    )
    return rows if rate_hz is None else np.column_stack([np.arange(len(rows)) / rate_hz, rows])


def _read(model: type[BaseModel], data: str | bytes) -> Any:
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise ValueError(f"{where}: {first['msg']}: expected {FORMS}") from None


def waypoints_of(plan_text: str) -> dict[str, Any]:
    """The keys of a trajectory through the places of a plan, and the home from which their heights count.

    Raises:
        ValueError: the text is no plan, or one with other items than places, in words that follow the name of a file.
    """
    plan, places = _read(_Plan, plan_text), []
    for index, item in enumerate(plan.items):
        numbers = [number or 0.0 for number in item.params]
        known = item.command in (_WAYPOINT, _TAKEOFF) and item.frame in _ABOVE_HOME + _ABOVE_SEA
        if not known or item.complexItemType or len(numbers) != 7 or numbers[0]:
            name = item.complexItemType or _OTHERS.get(item.command, "command")
            what = f"{name} {item.command} in frame {item.frame}"
            raise ValueError(
                f"mission.items[{index}]: {what}: expected a take-off (22) or a waypoint (16) without a hold, at a "
                "height above home (frame 3) or the sea (0)"
            )
        here = item.command == _TAKEOFF and not any(numbers[4:6])
        lat, lon = plan.home[:2] if here else numbers[4:6]
        base = plan.home[2] if item.frame in _ABOVE_HOME else 0.0
        places.append({"lat": lat, "lon": lon, "alt": base + numbers[6]})
    home = dict(zip(("latitude_deg", "longitude_deg", "altitude_m"), plan.home, strict=True))
    return {"kind": "waypoints", "points_m": places, "speed_m_s": plan.speed, HOME: home}


def _show_text(data: bytes, drone: object) -> str:
    """The Bezier curves of a drone as polynomials."""
    try:
        with ZipFile(BytesIO(data)) as folder:
            drones = _read(_Show, _member(folder, "show.json")).drones
            if drone not in range(1, len(drones) + 1):
                raise ValueError(f"drone: {drone!r:.40}: expected 1 to {len(drones)}")
            path = drones[int(str(drone)) - 1].path
            if path.elsewhere:
                name = path.elsewhere.partition("#")[0].removeprefix("./")
                path = _read(_Path, _member(folder, name))
    except ValueError:
        raise
    except Exception as error:  # of zipfile and what it unpacks with
        raise ValueError(f"{error!r:.80}: expected {FORMS}") from None
    return "".join(_piece_text(index, *ends) for index, ends in enumerate(pairwise(path.points)))


def _member(folder: ZipFile, name: str) -> bytes:
    found = folder.getinfo(name)
    if found.file_size > _MOST_BYTES:
        raise ValueError(f"{name}: expected at most {_MOST_BYTES} bytes")
    return folder.read(found)


def _piece_text(index: int, first: _Point, last: _Point) -> str:
    from scipy.interpolate import BPoly, PPoly  # late: half a second

    span = last[0] - first[0]
    if not span > 0.0:
        raise ValueError(f"points[{index + 1}]: {last[0]:g} s: expected times that ascend")
    controls = np.array([first[1], *last[2], last[1]])
    powers = PPoly.from_bernstein_basis(BPoly(controls[:, None], [0.0, span])).c[::-1, 0].T
    row = np.zeros((3, COEFFICIENTS))
    row[:, : powers.shape[1]] = powers
    return ",".join(f"{number:.9g}" for number in (span, *row.ravel())) + "\n"
