"""Messages of flights as bytes, without ROS: states, setpoints, stamps, rows of numbers, transforms, diagnostics.

A template encodes messages whose frames are fixed: what does not change is built once. A decoder takes any frames.
A checked decoder takes what comes from outside, and refuses what no vehicle does: its limits are far above that, and
far below what overflows in a law. A flight in which one number of one message is NaN would be NaN from then on.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import hypot
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_io.wire.cdr import (
    LITTLE_ENDIAN_HEADER,
    NANOSECONDS,
    Floats,
    Stamped,
    WireError,
    align,
    byte_order,
    encode_string,
    float_bytes,
    header_bytes,
    pad,
    read_stamp,
    require,
    skip_string,
    split_stamp,
    stamp_bytes,
    string_at,
    write_stamp,
)
from ptnsbc_io.wire.pointcloud import decode_near

ODOMETRY_SIZE = 13
LARGEST_POSITION_M = 1e6
LARGEST_SPEED_M_S = 1e3
LARGEST_RATE_RAD_S = 1e3
LARGEST_FORCE_N = 1e6
LARGEST_TORQUE_N_M = 1e6
MOST_NEAR_OBJECTS = 1024
_WRENCH_LIMITS = ("force", LARGEST_FORCE_N), ("torque", LARGEST_TORQUE_N_M)
_VELOCITY_LIMITS = ("velocity", LARGEST_SPEED_M_S), ("angular velocity", LARGEST_RATE_RAD_S)

_ODOMETRY = "nav_msgs/Odometry"
_VELOCITY = "geometry_msgs/TwistStamped"
_WRENCH = "geometry_msgs/WrenchStamped"
_HEADER = "std_msgs/Header"
_CLOCK = "rosgraph_msgs/Clock"
_ROW = "std_msgs/MultiArray"
_DIAGNOSTICS = "diagnostic_msgs/DiagnosticArray"
_NEAR = "sensor_msgs/PointCloud2"

_LITTLE = LITTLE_ENDIAN_HEADER[:2]
_STAMP = struct.Struct("<iI")
_START = struct.Struct("<iII")  # stamp, length of frame_id
_LENGTH = struct.Struct("<I")
_FRAME_AT = 12  # after the encapsulation header and the stamp
_LABEL_AT = 8  # of a row: after the encapsulation header and the number of dimensions

# Bytes of the parts of a twist or wrench, and of an Odometry behind its frames
_VECTOR_PAIR = 6 * 8
_COVARIANCE = 36 * 8
_POSE = 7 * 8
_TWIST_AT = _POSE + _COVARIANCE
_NUMBERS = _TWIST_AT + _VECTOR_PAIR + _COVARIANCE
_UNKNOWN = bytes(_COVARIANCE)

# Norm of a quaternion: a unit quaternion rounded to float32 is off by less than 1e-6.
_LEAST_TURN, _LARGEST_TURN = 0.95, 1.05


class HeaderFields(NamedTuple):
    """A decoded std_msgs/Header."""

    stamp_ns: int  # [ns]
    frame_id: str


class _VectorPairTemplate:
    """A header and two vectors of three, as in twist and wrench."""

    _what: str

    def __init__(self, frame_id: str) -> None:
        buffer = header_bytes(frame_id)
        pad(buffer, 8)
        self._frame = bytes(buffer[_FRAME_AT:])

    def encode(self, stamp_ns: int, values: Floats) -> bytes:
        """The message of `values` (6,) at `stamp_ns` [ns]."""
        numbers = float_bytes(values, 6, self._what)
        return b"".join((LITTLE_ENDIAN_HEADER, stamp_bytes(stamp_ns), self._frame, numbers))


class VelocityTemplate(_VectorPairTemplate):
    """Encoder of geometry_msgs/TwistStamped: linear x y z [m/s], angular x y z [rad/s]."""

    _what = _VELOCITY


class WrenchTemplate(_VectorPairTemplate):
    """Encoder of geometry_msgs/WrenchStamped: force x y z [N], torque x y z [N m]."""

    _what = _WRENCH


class HeaderTemplate:
    """Encoder of std_msgs/Header with a fixed `frame_id` (the epoch: name of the leg)."""

    def __init__(self, frame_id: str) -> None:
        self._buffer = header_bytes(frame_id)

    def encode(self, stamp_ns: int) -> bytes:
        """The header at `stamp_ns` [ns]."""
        write_stamp(self._buffer, stamp_ns)
        return bytes(self._buffer)


class ClockTemplate:
    """Encoder of rosgraph_msgs/Clock."""

    def __init__(self) -> None:
        self._buffer = bytearray(LITTLE_ENDIAN_HEADER + bytes(8))

    def encode(self, stamp_ns: int) -> bytes:
        """The clock message of `stamp_ns` [ns]."""
        write_stamp(self._buffer, stamp_ns)
        return bytes(self._buffer)


def decode_velocity(buf: bytes) -> Stamped:
    """Stamp [ns] and (6,) linear [m/s], angular [rad/s] of a TwistStamped."""
    return _decode_vector_pair(buf, _VELOCITY)


def decode_wrench(buf: bytes) -> Stamped:
    """Stamp [ns] and (6,) force [N], torque [N m] of a WrenchStamped."""
    return _decode_vector_pair(buf, _WRENCH)


def decode_header(buf: bytes) -> HeaderFields:
    """Stamp [ns] and frame_id of a std_msgs/Header, or of a message that starts with one."""
    order = byte_order(buf, _HEADER)
    return HeaderFields(
        read_stamp(buf, order, 4, _HEADER), string_at(buf, order, _FRAME_AT, f"{_HEADER} frame_id")
    )


def decode_clock(buf: bytes) -> int:
    """The time [ns] of a rosgraph_msgs/Clock."""
    return read_stamp(buf, byte_order(buf, _CLOCK), 4, _CLOCK)


def peek_stamp(buf: bytes) -> int:
    """The stamp [ns] of any message that starts with a std_msgs/Header (or is a Clock)."""
    if buf[:2] == _LITTLE and len(buf) >= 12:
        seconds, nanoseconds = _STAMP.unpack_from(buf, 4)
        return int(seconds * NANOSECONDS + nanoseconds)
    return read_stamp(buf, byte_order(buf, "stamped message"), 4, "stamped message")


def peek_sequence_stamp(buf: bytes) -> int | None:
    """The stamp [ns] of the first element of a MarkerArray, TFMessage or other list of stamped elements.

    None when the list is empty.
    """
    what = "list of stamped messages"
    order = byte_order(buf, what)
    require(buf, 8, what)
    if not any(buf[4:8]):
        return None
    return read_stamp(buf, order, 8, what)


def _decode_vector_pair(buf: bytes, what: str) -> Stamped:
    # Fast path for a little-endian, complete message: a third of the time of the general one.
    if buf[:2] == _LITTLE and len(buf) >= _FRAME_AT + 4:
        seconds, nanoseconds, frame = _START.unpack_from(buf, 4)
        values_at = 12 + (frame + 11 & -8)
        if len(buf) >= values_at + _VECTOR_PAIR:
            numbers = bytearray(buf[values_at : values_at + _VECTOR_PAIR])
            return Stamped(seconds * NANOSECONDS + nanoseconds, np.frombuffer(numbers, np.float64))
    order = byte_order(buf, what)
    stamp_ns = read_stamp(buf, order, 4, what)
    values_at = align(skip_string(buf, order, _FRAME_AT, what), 8)
    require(buf, values_at + _VECTOR_PAIR, what)
    values = np.frombuffer(buf, f"{order}f8", 6, values_at)
    return Stamped(stamp_ns, values.astype(np.float64))


# nav_msgs/Odometry as a flat vector of 13, the state message of the formation:
#     position x y z [m] | quaternion x y z w [-] | linear velocity x y z [m/s] | angular velocity x y z [rad/s]
# Position and attitude are in `header.frame_id`, velocities in `child_frame_id`, as in the message.
# Covariances are sent as zeros (unknown) and skipped on receipt.


class OdometryTemplate:
    """Encoder of Odometry messages with fixed frames, assembled from prebuilt parts.

    Building the message object and serialising it costs rclpy 31 µs; this costs about one.
    """

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        buffer = header_bytes(frame_id)
        pad(buffer, 4)
        buffer += encode_string(child_frame_id)
        pad(buffer, 8)
        self._frames = bytes(buffer[_FRAME_AT:])

    def encode(self, stamp_ns: int, odom13: Floats) -> bytes:
        """The message of `odom13` (13,) at `stamp_ns` [ns]."""
        numbers = float_bytes(odom13, ODOMETRY_SIZE, _ODOMETRY)
        return b"".join(
            (
                LITTLE_ENDIAN_HEADER,
                stamp_bytes(stamp_ns),
                self._frames,
                numbers[:_POSE],
                _UNKNOWN,
                numbers[_POSE:],
                _UNKNOWN,
            )
        )


def decode_odometry(buf: bytes) -> Stamped:
    """Stamp [ns] and odom vector (13,) of a serialised Odometry with any frame names."""
    size = len(buf)
    if size > _NUMBERS and buf[:2] == _LITTLE:
        # Fast path for a little-endian, complete message: a third of the time of the general one.
        seconds, nanoseconds, frame = _START.unpack_from(buf, 4)
        child_at = 16 + (frame + 3 & -4)
        if child_at < size - 4:
            pose_at = 12 + (child_at + _LENGTH.unpack_from(buf, child_at)[0] - 1 & -8)
            if pose_at + _NUMBERS <= size:
                twist_at = pose_at + _TWIST_AT
                # Joined as bytes first: one array from 104 bytes is faster than two filled slices.
                numbers = bytearray(buf[pose_at : pose_at + _POSE])
                numbers += buf[twist_at : twist_at + _VECTOR_PAIR]
                stamp_ns = seconds * NANOSECONDS + nanoseconds
                return Stamped(stamp_ns, np.frombuffer(numbers, np.float64))
    order = byte_order(buf, _ODOMETRY)
    stamp_ns = read_stamp(buf, order, 4, _ODOMETRY)
    child_at = align(skip_string(buf, order, _FRAME_AT, _ODOMETRY), 4)
    pose_at = align(skip_string(buf, order, child_at, _ODOMETRY), 8)
    require(buf, pose_at + _NUMBERS, _ODOMETRY)
    twist_at = pose_at + _TWIST_AT
    raw = buf[pose_at : pose_at + _POSE] + buf[twist_at : twist_at + _VECTOR_PAIR]
    return Stamped(stamp_ns, np.frombuffer(raw, f"{order}f8").astype(np.float64))


# std_msgs/Int64MultiArray and Float64MultiArray: rows of numbers whose layout names each of them.
#     layout.dim[0].label = "name name:count ..." | size = stride = length | data


class Row(NamedTuple):
    """A decoded array of one dimension."""

    label: str
    values: NDArray[np.int64] | Floats  # (n,)


class RowTemplate:
    """Encoder of arrays with the same label and length: one prebuilt message, patched."""

    def __init__(self, label: str, length: int) -> None:
        self._length = length
        buffer = bytearray(LITTLE_ENDIAN_HEADER + struct.pack("<I", 1)) + encode_string(label)
        pad(buffer, 4)
        buffer += struct.pack("<IIII", length, length, 0, length)
        pad(buffer, 8)
        self._start = bytes(buffer)

    def integers(self, values: list[int]) -> bytes:
        """Int64MultiArray of `values`."""
        return self._start + struct.pack(f"<{self._length}q", *values)

    def floats(self, values: Floats) -> bytes:
        """Float64MultiArray of `values` (n,)."""
        return self._start + float_bytes(values, self._length, _ROW)


def decode_integers(buf: bytes) -> Row:
    """Label and values of an Int64MultiArray."""
    return _decode_row(buf, "i8")


def decode_floats(buf: bytes) -> Row:
    """Label and values of a Float64MultiArray."""
    return _decode_row(buf, "f8")


def _decode_row(buf: bytes, kind: str) -> Row:
    order = byte_order(buf, _ROW)
    require(buf, _LABEL_AT, _ROW)
    (dimensions,) = struct.unpack_from(f"{order}I", buf, 4)
    if dimensions != 1:
        raise WireError(f"{_ROW}: {dimensions} dimensions: expected 1")
    label = string_at(buf, order, _LABEL_AT, _ROW)
    count_at = align(skip_string(buf, order, _LABEL_AT, _ROW), 4) + 12
    require(buf, count_at + 4, _ROW)
    (count,) = struct.unpack_from(f"{order}I", buf, count_at)
    values_at = align(count_at + 4, 8)
    require(buf, values_at + 8 * count, _ROW)
    values = np.frombuffer(buf, f"{order}{kind}", count, values_at)
    return Row(label, values.astype(values.dtype.newbyteorder("=")))


def transform_of(odometry: bytes) -> bytes | None:
    """A tf2_msgs/TFMessage with one transform, `header.frame_id` to `child_frame_id` of a serialised Odometry.

    tf2_msgs has no wheel: so bags hold /tf without it.

    None when the Odometry does not name both frames. WireError when it is not an Odometry.
    """
    state = decode_odometry(odometry)
    order = byte_order(odometry, _ODOMETRY)
    parent = string_at(odometry, order, 12, f"{_ODOMETRY} frame_id")
    child_at = align(skip_string(odometry, order, 12, _ODOMETRY), 4)
    child = string_at(odometry, order, child_at, f"{_ODOMETRY} child_frame_id")
    if not parent or not child:
        return None
    out = bytearray(LITTLE_ENDIAN_HEADER)
    out += struct.pack("<IiI", 1, *split_stamp(state.stamp_ns))
    out += encode_string(parent)
    pad(out, 4)
    out += encode_string(child)
    pad(out, 8)
    out += float_bytes(state.values[:7], 7, _ODOMETRY)  # the pose, in the same order
    return bytes(out)


class DiagnosticStatus(NamedTuple):
    """One status of an array."""

    name: str  # "uav3: planner"
    level: int
    message: str
    values: dict[str, str]


class Diagnostics(NamedTuple):
    """A decoded array."""

    stamp_ns: int
    statuses: tuple[DiagnosticStatus, ...]


class _Cursor:
    """Reads the fields of a message one after the other."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._order = byte_order(data, _DIAGNOSTICS)
        self._at = 12  # after the encapsulation header and the stamp

    def stamp(self) -> int:
        return read_stamp(self._data, self._order, 4, _DIAGNOSTICS)

    def count(self) -> int:
        self._at = align(self._at, 4)
        require(self._data, self._at + 4, _DIAGNOSTICS)
        value = struct.unpack_from(f"{self._order}I", self._data, self._at)[0]
        self._at += 4
        return int(value)

    def text(self) -> str:
        start = align(self._at, 4)
        value = string_at(self._data, self._order, start, _DIAGNOSTICS)
        self._at = skip_string(self._data, self._order, start, _DIAGNOSTICS)
        return value

    def octet(self) -> int:
        require(self._data, self._at + 1, _DIAGNOSTICS)
        self._at += 1
        return self._data[self._at - 1]


def _status(cursor: _Cursor) -> DiagnosticStatus:
    level = cursor.octet()
    name, message = cursor.text(), cursor.text()
    cursor.text()  # hardware_id
    values = {}
    for _ in range(cursor.count()):
        key = cursor.text()
        values[key] = cursor.text()
    return DiagnosticStatus(name, level, message, values)


def decode_diagnostics(data: bytes) -> Diagnostics:
    """Stamp [ns] and statuses of a serialised DiagnosticArray."""
    cursor = _Cursor(data)
    stamp_ns = cursor.stamp()
    cursor.text()  # frame_id
    return Diagnostics(stamp_ns, tuple(_status(cursor) for _ in range(cursor.count())))


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
            self._frames = bytes(buffer[_FRAME_AT:]) + encode_string(child_frame_id)

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
        if frames is not None and not (buf[:2] == _LITTLE and buf.startswith(frames, _FRAME_AT)):
            self._check_frames(buf)
        return message

    def _check_frames(self, buf: bytes) -> None:
        """The general way: rclpy leaves old memory in the gaps between the names."""
        order = byte_order(buf, _ODOMETRY)
        child_at = align(skip_string(buf, order, _FRAME_AT, _ODOMETRY), 4)
        found = tuple(string_at(buf, order, at, _ODOMETRY) for at in (_FRAME_AT, child_at))
        if found != self._names:
            shown = " and ".join(repr(name[:40]) for name in found)
            expected = " and ".join(map(repr, self._names))
            raise WireError(f"{_ODOMETRY}: frames {shown}: expected {expected}")


def checked_wrench(buf: bytes) -> Stamped:
    """`decode_wrench`; WireError for a force or torque that no vehicle produces."""
    return _checked_pair(decode_wrench(buf), _WRENCH, _WRENCH_LIMITS)


def checked_velocity(buf: bytes) -> Stamped:
    """`decode_velocity`; WireError for a velocity that no vehicle reaches."""
    return _checked_pair(decode_velocity(buf), _VELOCITY, _VELOCITY_LIMITS)


def _checked_pair(
    message: Stamped, what: str, limits: tuple[tuple[str, float], tuple[str, float]]
) -> Stamped:
    numbers = message.values.tolist()
    for vector, (quantity, limit) in zip((numbers[:3], numbers[3:]), limits, strict=True):
        if not hypot(*vector) < limit:
            raise _refuse(what, quantity, vector, limit)
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
