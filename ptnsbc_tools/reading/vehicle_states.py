"""States of vehicles in the bags of other systems: which topic holds which UAV, and how a message becomes a state.

A state is (13,) as in nav_msgs/Odometry: position and attitude in the world (ENU), velocities in the body (FLU).
Messages that hold a pose alone get the velocity between it and the one before, and no angular velocity.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.types import Array
from ptnsbc_io.cdr import Reader
from ptnsbc_io.mavlink.frames import (
    EARTH_RADIUS_M,
    GeoPoint,
    offset_enu,
    quaternion_ned_frd_to_enu_flu,
    vector_frd_to_flu,
    vector_ned_to_enu,
)
from ptnsbc_io.wire import Stamped, decode_odometry
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools.options import UAV, ReadOptions, TopicPatternError

_ODOMETRY = "nav_msgs/msg/Odometry"
_PX4 = "px4_msgs/msg/VehicleOdometry"
_LONGEST_OFFSET_NS = 3600 * 10**9
_OF_UAV = re.compile(r"([0-9]{1,3})=(.+)")
_BEFORE_UAV = re.compile(r",(?=[0-9]+=)")
_NUMBER = r"([-+]?[0-9]+(?:\.[0-9]*)?)"
_METRES = re.compile(f"{_NUMBER},{_NUMBER},{_NUMBER}")
_DEGREES = re.compile(f"{_NUMBER}([NS]),{_NUMBER}([EW]),{_NUMBER}")


def _pose(data: bytes, _frame: str) -> Stamped:
    """Of PoseStamped and PoseWithCovarianceStamped: stamp and (7,), quaternion x y z w."""
    reader = Reader(data, "geometry_msgs/PoseStamped")
    stamp_ns, _ = reader.stamp(), reader.text()
    return Stamped(stamp_ns, np.array(reader.numbers("7d", 8)))


def _transform(data: bytes, frame: str) -> Stamped | None:
    """Of TFMessage: the pose of a frame in its parent; None where the message does not have it."""
    reader = Reader(data, "tf2_msgs/TFMessage")
    for _ in range(*reader.numbers("I")):
        stamp_ns, _, child = reader.stamp(), reader.text(), reader.text()
        pose = reader.numbers("7d", 8)
        if child.strip("/") == frame:
            return Stamped(stamp_ns, np.array(pose))
    return None


def _vehicle_odometry(data: bytes, _frame: str) -> Stamped | None:
    """Of px4_msgs/VehicleOdometry: the fields that all its versions begin with; None before a position is known."""
    reader = Reader(data, "px4_msgs/VehicleOdometry")
    stamp_us, _ = reader.numbers("QQ", 8)
    reader.take(1)  # kind of the frame, numbered differently in the versions
    x, y, z, qw, qx, qy, qz = reader.numbers("7f")
    pose = np.array((x, y, z, qx, qy, qz, qw))
    return Stamped(1000 * int(stamp_us), pose) if np.isfinite(pose).all() else None


_POSES: Mapping[str, Callable[[bytes, str], Stamped | None]] = {
    "geometry_msgs/msg/PoseStamped": _pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose,
    "tf2_msgs/msg/TFMessage": _transform,
    _PX4: _vehicle_odometry,
}


def state_readers(options: ReadOptions, scenario: Scenario) -> dict[int, StateReader]:
    """The reader of every UAV; TopicPatternError for a text that names none."""
    mapped = _by_uav("topic", options.mapped, scenario, "/cf231/pose, or /tf:cf231")
    origins = _by_uav("origin", options.origins, scenario, "0,2.5,0, or 47.3977N,8.5456E,488")
    datum = scenario.mavlink.world_origin
    reference = datum and datum.place
    readers = {}
    for uav in scenario.uav_ids:
        place = _place(origins.get(uav, "0,0,0"))
        if isinstance(place, GeoPoint):
            reference = reference or place
            place = offset_enu(place, reference, EARTH_RADIUS_M[scenario.mavlink.autopilot])
        name = mapped.get(uav, options.odom.replace(UAV, str(uav)))
        readers[uav] = StateReader(name, place, ned=options.frame == "ned")
    return readers


def _by_uav(
    what: str, texts: Sequence[str] | None, scenario: Scenario, example: str
) -> dict[int, str]:
    """The values of `N=VALUE`, of which one text may hold several."""
    found = dict[int, str]()
    for text in (part for one in texts or () for part in _BEFORE_UAV.split(one)):
        match = _OF_UAV.fullmatch(text)
        if match is None or int(match[1]) not in set(scenario.uav_ids) - found.keys():
            raise TopicPatternError(
                f"{what} of a UAV: {text}: expected N=VALUE with N one of {', '.join(map(str, scenario.uav_ids))}, "
                f"each once, and a value like {example}"
            )
        found[int(match[1])] = match[2]
    return found


def _place(text: str) -> Array | GeoPoint:
    """A position in metres, or one on the Earth."""
    if metres := _METRES.fullmatch(text):
        return np.array([float(number) for number in metres.groups()])
    degrees = _DEGREES.fullmatch(text)
    if degrees is None:
        raise TopicPatternError(
            f"origin of a UAV: {text}: expected x,y,z [m] or latitude, longitude and altitude, as 47.3977N,8.5456E,488"
        )
    north, east = (float(degrees[k]) * (1 if degrees[k + 1] in "NE" else -1) for k in (1, 3))
    return GeoPoint(north, east, float(degrees[5]))


Decoder = Callable[[bytes, int], Stamped | None]
"""Makes a state of a message and its log time [ns]; None where the message has none."""


class StateReader:
    """Reads the states of a UAV, message by message.

    `name`: topic, and behind a colon the frame of the vehicle; `origin`: zero of its positions (3,) [m], in the world.
    """

    def __init__(self, name: str, origin: Array, *, ned: bool) -> None:
        self.name, self._origin, self._ned = name, origin, ned
        self.topic, _, frame = name.partition(":")
        self._frame = frame.strip("/")
        self._newest = Stamped(0, np.zeros(13))

    @property
    def decoders(self) -> dict[str, Decoder]:
        """The functions that make states of messages, by their type."""
        plain = not self._ned and not self._origin.any()
        of_odometry = (lambda data, _: decode_odometry(data)) if plain else self._of_odometry
        return {_ODOMETRY: of_odometry} | {kind: partial(self._of_pose, kind) for kind in _POSES}

    def _of_odometry(self, data: bytes, _log_ns: int) -> Stamped:
        stamp_ns, values = decode_odometry(data)
        if self._ned:
            twist = vector_frd_to_flu(values[7:10]), vector_frd_to_flu(values[10:13])
            values = np.concatenate((_in_enu(values[:7]), *twist))
        values[:3] += self._origin
        return Stamped(stamp_ns, values)

    def _of_pose(self, kind: str, data: bytes, log_ns: int) -> Stamped | None:
        found = _POSES[kind](data, self._frame)
        if found is None:
            return None
        stamp_ns, pose = found
        # Each vehicle's own time since it was switched on is no common clock; zeros let the log times count.
        if kind == _PX4 and abs(stamp_ns - log_ns) > _LONGEST_OFFSET_NS:
            stamp_ns = 0
        pose = _in_enu(pose) if self._ned or kind == _PX4 else pose
        position = pose[:3] + self._origin
        time_ns, before = stamp_ns or log_ns, self._newest
        values = np.concatenate((position, pose[3:], before.values[7:]))
        if before.stamp_ns and time_ns > before.stamp_ns:
            velocity = (position - before.values[:3]) / (1e-9 * (time_ns - before.stamp_ns))
            values[7:10] = rotation_from_quaternion(pose[3:]).T @ velocity
        self._newest = Stamped(time_ns, values)
        return Stamped(stamp_ns, values)


def _in_enu(pose: Array) -> Array:
    """A pose (7,) in NED, of a body FRD, in ENU and FLU."""
    turn = quaternion_ned_frd_to_enu_flu(pose[[6, 3, 4, 5]])
    return np.concatenate((vector_ned_to_enu(pose[:3]), turn))
