"""Decoders for messages from outside: finite numbers in a possible range, and the frames of the sender.

The limits are far above what a vehicle does, and far below what overflows in a law. A message beyond them, or one
that is not finite, raises WireError. A flight in which one number of one message is NaN would be NaN from then on.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

from ptnsbc_io.wire.cdr import (
    LITTLE_ENDIAN_HEADER,
    Stamped,
    WireError,
    align,
    byte_order,
    encode_string,
    header_bytes,
    pad,
    skip_string,
    string_at,
)
from ptnsbc_io.wire.odometry import decode_odometry
from ptnsbc_io.wire.pointcloud import decode_near
from ptnsbc_io.wire.stamped import decode_velocity, decode_wrench

LARGEST_POSITION_M = 1e6
LARGEST_SPEED_M_S = 1e3
LARGEST_RATE_RAD_S = 1e3
LARGEST_FORCE_N = 1e6
LARGEST_TORQUE_N_M = 1e6
MOST_NEAR_OBJECTS = 1024

# Norm of a quaternion: a unit quaternion rounded to float32 is off by less than 1e-6.
_LEAST_TURN, _LARGEST_TURN = 0.95, 1.05
_ODOMETRY = "nav_msgs/Odometry"
_WRENCH = "geometry_msgs/WrenchStamped"
_VELOCITY = "geometry_msgs/TwistStamped"
_NEAR = "sensor_msgs/PointCloud2"
_LITTLE = LITTLE_ENDIAN_HEADER[:2]
_FRAMES_AT = 12  # after the encapsulation header and the stamp


def _refuse(what: str, quantity: str, numbers: Sequence[float], limit: float) -> WireError:
    shown = ", ".join(f"{number:g}" for number in numbers)
    return WireError(f"{what}: {quantity} {shown}: expected finite numbers, norm below {limit:g}")


class OdometryDecoder:
    """Decoder of the Odometry of one sender.

    Args:
        frame_id: the frame of the pose that the sender must name; None: any.
        child_frame_id: the frame of the velocities, None with a `frame_id` of None.
    """

    def __init__(self, frame_id: str | None = None, child_frame_id: str | None = None) -> None:
        self._names = (frame_id, child_frame_id)
        self._frames: bytes | None = None
        if frame_id is not None and child_frame_id is not None:
            buffer = header_bytes(frame_id)
            pad(buffer, 4)
            self._frames = bytes(buffer[_FRAMES_AT:]) + encode_string(child_frame_id)

    def __call__(self, buf: bytes) -> Stamped:
        """Stamp [ns] and odometry vector (13,); WireError when the message is refused."""
        message = decode_odometry(buf)
        # A norm is nan or inf when one of its numbers is; hypot does not overflow.
        x, y, z, i, j, k, w, u, v, n, p, q, r = message.values.tolist()
        if not hypot(x, y, z) < LARGEST_POSITION_M:
            raise _refuse(_ODOMETRY, "position", (x, y, z), LARGEST_POSITION_M)
        if not _LEAST_TURN < hypot(i, j, k, w) < _LARGEST_TURN:
            raise WireError(f"{_ODOMETRY}: quaternion of norm {hypot(i, j, k, w):.3g}: expected 1")
        if not hypot(u, v, n) < LARGEST_SPEED_M_S:
            raise _refuse(_ODOMETRY, "velocity", (u, v, n), LARGEST_SPEED_M_S)
        if not hypot(p, q, r) < LARGEST_RATE_RAD_S:
            raise _refuse(_ODOMETRY, "angular velocity", (p, q, r), LARGEST_RATE_RAD_S)
        frames = self._frames
        if frames is not None and not (buf[:2] == _LITTLE and buf.startswith(frames, _FRAMES_AT)):
            self._check_frames(buf)
        return message

    def _check_frames(self, buf: bytes) -> None:
        """The general way: rclpy leaves old memory in the gaps between the names."""
        order = byte_order(buf, _ODOMETRY)
        child_at = align(skip_string(buf, order, _FRAMES_AT, _ODOMETRY), 4)
        found = tuple(string_at(buf, order, at, _ODOMETRY) for at in (_FRAMES_AT, child_at))
        if found != self._names:
            shown = " and ".join(repr(name[:40]) for name in found)
            expected = " and ".join(map(repr, self._names))
            raise WireError(f"{_ODOMETRY}: frames {shown}: expected {expected}")


def checked_wrench(buf: bytes) -> Stamped:
    """`decode_wrench`; WireError for a force or torque that no vehicle produces."""
    message = decode_wrench(buf)
    x, y, z, p, q, r = message.values.tolist()
    if not hypot(x, y, z) < LARGEST_FORCE_N:
        raise _refuse(_WRENCH, "force", (x, y, z), LARGEST_FORCE_N)
    if not hypot(p, q, r) < LARGEST_TORQUE_N_M:
        raise _refuse(_WRENCH, "torque", (p, q, r), LARGEST_TORQUE_N_M)
    return message


def checked_velocity(buf: bytes) -> Stamped:
    """`decode_velocity`; WireError for a velocity that no vehicle reaches."""
    message = decode_velocity(buf)
    x, y, z, p, q, r = message.values.tolist()
    if not hypot(x, y, z) < LARGEST_SPEED_M_S:
        raise _refuse(_VELOCITY, "velocity", (x, y, z), LARGEST_SPEED_M_S)
    if not hypot(p, q, r) < LARGEST_RATE_RAD_S:
        raise _refuse(_VELOCITY, "angular velocity", (p, q, r), LARGEST_RATE_RAD_S)
    return message


def checked_near(buf: bytes) -> Stamped:
    """`decode_near`; WireError for too many objects, or for one that cannot be.

    `decode_near` leaves out points that are not finite, because a sensor marks "no return" that way.
    """
    message = decode_near(buf)
    rows = message.values
    if len(rows) > MOST_NEAR_OBJECTS:
        raise WireError(f"{_NEAR}: {len(rows)} objects: expected at most {MOST_NEAR_OBJECTS}")
    for x, y, z, radius, u, v, n in rows.tolist():
        if not hypot(x, y, z) < LARGEST_POSITION_M:
            raise _refuse(_NEAR, "position", (x, y, z), LARGEST_POSITION_M)
        if not 0.0 <= radius < LARGEST_POSITION_M:
            raise WireError(f"{_NEAR}: radius {radius:g} m: expected 0 or more")
        if not hypot(u, v, n) < LARGEST_SPEED_M_S:
            raise _refuse(_NEAR, "velocity", (u, v, n), LARGEST_SPEED_M_S)
    return message
