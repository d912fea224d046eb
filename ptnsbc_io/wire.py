"""Messages of flights as bytes, without ROS: states, setpoints, stamps, rows, transforms, diagnostics, clouds.

`raw=True` publishers and subscriptions carry them.

A template encodes messages whose frames are fixed: what does not change is built once. A decoder takes any frames.
A checked decoder takes what comes from outside, and refuses what no vehicle does: its limits are far above that, and
far below what overflows in a law. A flight in which one number of one message is NaN would be NaN from then on.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache
from math import hypot
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.nanoseconds import SECOND_NS
from ptnsbc_core.types import ODOMETRY_SIZE
from ptnsbc_io.cdr import (
    LITTLE_ENDIAN_HEADER,
    TIME,
    Floats,
    Reader,
    aligned_string,
    byte_order,
    cut,
    encode_string,
    float_bytes,
    header_bytes,
    pad,
    stamp_bytes,
)
from ptnsbc_io.cdr import Stamped as Stamped
from ptnsbc_io.cdr import WireError as WireError

LARGEST_POSITION_M = 1e6
LARGEST_SPEED_M_S = 1e3
LARGEST_RATE_RAD_S = 1e3
LARGEST_FORCE_N = 1e6
LARGEST_TORQUE_N_M = 1e6
MOST_NEAR_OBJECTS = 1024
_WRENCH_LIMITS = ("force", LARGEST_FORCE_N), ("torque", LARGEST_TORQUE_N_M)
_VELOCITY_LIMITS = ("velocity", LARGEST_SPEED_M_S), ("angular velocity", LARGEST_RATE_RAD_S)

_ODOMETRY = "nav_msgs/Odometry"
_POSE_STAMPED = "geometry_msgs/PoseStamped"
_VELOCITY = "geometry_msgs/TwistStamped"
_WRENCH = "geometry_msgs/WrenchStamped"
_HEADER = "std_msgs/Header"
_ROW = "std_msgs/MultiArray"
_DIAGNOSTICS = "diagnostic_msgs/DiagnosticArray"
_NEAR = "sensor_msgs/PointCloud2"

_LITTLE = LITTLE_ENDIAN_HEADER[:2]
_START = {order: struct.Struct(f"{order}iII") for order in "<>"}  # stamp, length of frame_id
_LENGTH = {order: struct.Struct(f"{order}I") for order in "<>"}
_FLOAT64 = {order: np.dtype(f"{order}f8") for order in "<>"}
_FLOAT = np.dtype(np.float64)
_FRAME_AT = 12  # after the encapsulation header and the stamp

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
        self._frame = encode_string(frame_id)

    def encode(self, stamp_ns: int) -> bytes:
        """The header at `stamp_ns` [ns]."""
        return LITTLE_ENDIAN_HEADER + stamp_bytes(stamp_ns) + self._frame


def encode_clock(stamp_ns: int) -> bytes:
    """The rosgraph_msgs/Clock of `stamp_ns` [ns]."""
    return LITTLE_ENDIAN_HEADER + stamp_bytes(stamp_ns)


def decode_velocity(buf: bytes) -> Stamped:
    """Stamp [ns] and (6,) linear [m/s], angular [rad/s] of a TwistStamped."""
    return _decode_vector_pair(buf, _VELOCITY)


def decode_wrench(buf: bytes) -> Stamped:
    """Stamp [ns] and (6,) force [N], torque [N m] of a WrenchStamped."""
    return _decode_vector_pair(buf, _WRENCH)


def decode_header(buf: bytes) -> HeaderFields:
    """Stamp [ns] and frame_id of a std_msgs/Header, or of a message that starts with one."""
    stamp_ns, reader = peek_stamp(buf, _HEADER), Reader(buf, _HEADER, _FRAME_AT)
    return HeaderFields(stamp_ns, reader.text())


def peek_stamp(buf: bytes, what: str = "stamped message", at: int = 4) -> int:
    """The stamp [ns] of any message that starts with a std_msgs/Header (or is a Clock), or that is `at` this byte."""
    order = "<" if buf[:2] == _LITTLE else byte_order(buf, what)
    try:
        seconds, nanoseconds = TIME[order].unpack_from(buf, at)
    except struct.error:
        raise cut(buf, what, at + 8) from None
    return int(seconds * SECOND_NS + nanoseconds)


def peek_sequence_stamp(buf: bytes) -> int | None:
    """The stamp [ns] of the first element of a MarkerArray, TFMessage or other list of stamped elements.

    None when the list is empty.
    """
    what = "list of stamped messages"
    if buf[4:8] == bytes(4):
        byte_order(buf, what)  # refuses what is none
        return None
    return peek_stamp(buf, what, 8)


def _after_frames(buf: bytes, what: str, frames: int, size: int) -> tuple[str, int, int]:
    """Byte order, stamp [ns], and where the numbers begin behind one frame or two; WireError unless `size` follow.

    Odometry and setpoints are most of the traffic: this takes a quarter of the time of a Reader.
    """
    order = "<" if buf[:2] == _LITTLE else byte_order(buf, what)
    try:
        seconds, nanoseconds, length = _START[order].unpack_from(buf, 4)
        at = 16 + length
        if frames == 2:
            at = 16 + (length + 3 & -4)
            at += 4 + _LENGTH[order].unpack_from(buf, at)[0]
        at = 4 + (at + 3 & -8)
    except struct.error:
        at = len(buf) + 1
    if at + size > len(buf):
        raise cut(buf, what, at + size)
    return order, seconds * SECOND_NS + nanoseconds, at


def _floats(raw: bytearray, order: str) -> Floats:
    """Numbers of our own byte order in these bytes: to copy them as bytes is the cheapest way."""
    values = np.frombuffer(raw, _FLOAT64[order])
    return values if order == "<" else values.astype(_FLOAT)


def _decode_vector_pair(buf: bytes, what: str) -> Stamped:
    order, stamp_ns, at = _after_frames(buf, what, 1, _VECTOR_PAIR)
    return Stamped(stamp_ns, _floats(bytearray(buf[at : at + _VECTOR_PAIR]), order))


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
    order, stamp_ns, at = _after_frames(buf, _ODOMETRY, 2, _NUMBERS)
    twist_at = at + _TWIST_AT
    # Joined as bytes first: one array from 104 bytes is faster than two filled slices.
    raw = bytearray(buf[at : at + _POSE])
    raw += buf[twist_at : twist_at + _VECTOR_PAIR]
    return Stamped(stamp_ns, _floats(raw, order))


def decode_pose(buf: bytes) -> Stamped:
    """Stamp [ns] and (7,) position x y z [m], quaternion x y z w of a PoseStamped with any frame name."""
    order, stamp_ns, at = _after_frames(buf, _POSE_STAMPED, 1, _POSE)
    return Stamped(stamp_ns, _floats(bytearray(buf[at : at + _POSE]), order))


def decode_transform(buf: bytes, child_frame_id: str) -> Stamped | None:
    """The same of the transform to this frame in a TFMessage; None where it has none."""
    reader = Reader(buf, "tf2_msgs/TFMessage")
    for _ in range(*reader.numbers("I")):
        stamp_ns, _parent, child = reader.stamp(), reader.text(), reader.text()
        pose = reader.numbers("ddddddd", 8)
        if child == child_frame_id:
            return Stamped(stamp_ns, np.array(pose))
    return None


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
    reader = Reader(buf, _ROW)
    (dimensions,) = reader.numbers("I")
    if dimensions != 1:
        raise WireError(f"{_ROW}: {dimensions} dimensions: expected 1")
    label = reader.text()
    *_, count = reader.numbers("IIII")  # size, stride, offset, length
    values = np.frombuffer(reader.take(8 * count, 8), reader.order + kind)
    return Row(label, values.astype(kind))


def transform_of(odometry: bytes) -> bytes | None:
    """A tf2_msgs/TFMessage with one transform, `header.frame_id` to `child_frame_id` of a serialised Odometry.

    tf2_msgs has no wheel: so bags hold /tf without it.

    None when the Odometry does not name both frames. WireError when it is not an Odometry.
    """
    order, stamp_ns, at = _after_frames(odometry, _ODOMETRY, 2, _NUMBERS)
    frames = _transform_frames(bytes(odometry[:4] + odometry[_FRAME_AT:at]))
    if frames is None:
        return None
    pose = np.frombuffer(odometry, _FLOAT64[order], 7, at).astype("<f8").tobytes()
    return LITTLE_ENDIAN_HEADER + _LENGTH["<"].pack(1) + stamp_bytes(stamp_ns) + frames + pose


@lru_cache(maxsize=64)
def _transform_frames(frames: bytes) -> bytes | None:
    """The two frames of an Odometry, behind its encapsulation header, as a transform has them; None without both."""
    reader = Reader(frames, _ODOMETRY)
    parent, child = reader.text(), reader.text()
    out = bytearray(16) + encode_string(parent)  # as far as the stamp
    pad(out, 4)
    out += encode_string(child)
    pad(out, 8)
    return bytes(out[16:]) if parent and child else None


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


def decode_diagnostics(data: bytes) -> Diagnostics:
    """Stamp [ns] and statuses of a serialised DiagnosticArray."""
    reader = Reader(data, _DIAGNOSTICS)
    stamp_ns = reader.stamp()
    reader.text()  # frame_id
    statuses = []
    for _ in range(*reader.numbers("I")):
        (level,) = reader.numbers("B", 1)
        name, message, _ = reader.text(), reader.text(), reader.text()  # hardware_id
        values = {reader.text(): reader.text() for _ in range(*reader.numbers("I"))}
        statuses.append(DiagnosticStatus(name, level, message, values))
    return Diagnostics(stamp_ns, tuple(statuses))


def _refuse(what: str, quantity: str, numbers: Sequence[float], limit: float) -> WireError:
    shown = ", ".join(f"{number:g}" for number in numbers)
    return WireError(f"{what}: {quantity} {shown}: expected finite numbers, norm below {limit:g}")


class OdometryDecoder:
    """Decoder of the Odometry of one sender, which must name these frames; None: any."""

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
            # The general way: rclpy leaves old memory in the gaps between the names.
            reader = Reader(buf, _ODOMETRY)
            reader.stamp()
            found = (reader.text(), reader.text())
            if found != self._names:
                shown = " and ".join(repr(name[:40]) for name in found)
                expected = " and ".join(map(repr, self._names))
                raise WireError(f"{_ODOMETRY}: frames {shown}: expected {expected}")
        return message


def checked_wrench(buf: bytes) -> Stamped:
    """`decode_wrench`; WireError for a force or torque that no vehicle produces."""
    return _checked_pair(buf, _WRENCH, _WRENCH_LIMITS)


def checked_velocity(buf: bytes) -> Stamped:
    """`decode_velocity`; WireError for a velocity that no vehicle reaches."""
    return _checked_pair(buf, _VELOCITY, _VELOCITY_LIMITS)


def _checked_pair(buf: bytes, what: str, limits: tuple[tuple[str, float], ...]) -> Stamped:
    message = _decode_vector_pair(buf, what)
    x, y, z, p, q, r = message.values.tolist()
    (linear, most_linear), (angular, most_angular) = limits
    if not hypot(x, y, z) < most_linear:
        raise _refuse(what, linear, (x, y, z), most_linear)
    if not hypot(p, q, r) < most_angular:
        raise _refuse(what, angular, (p, q, r), most_angular)
    return message


def checked_near(buf: bytes) -> Stamped:
    """`decode_near`; WireError for too many objects, for one that cannot be, or for the frame of a body.

    `decode_near` leaves out points that are not finite, because a sensor marks "no return" that way.
    """
    message, frame = decode_near(buf), decode_header(buf).frame_id
    if frame.endswith("base_link"):  # REP-105
        raise WireError(f"{_NEAR}: frame {frame[-40:]!r}: expected positions in the world's frame")
    rows = message.values
    if len(rows) > MOST_NEAR_OBJECTS:
        raise WireError(f"{_NEAR}: {len(rows)} objects: expected at most {MOST_NEAR_OBJECTS}")
    for x, y, z, radius, u, v, n, above in rows.tolist():
        if not hypot(x, y, z) < LARGEST_POSITION_M:
            raise _refuse(_NEAR, "position", (x, y, z), LARGEST_POSITION_M)
        if not 0.0 <= radius < LARGEST_POSITION_M:
            raise WireError(f"{_NEAR}: radius {radius:g} m: expected 0 or more")
        if not 0.0 <= above < LARGEST_POSITION_M:
            raise WireError(f"{_NEAR}: above {above:g} m: expected 0 or more")
        if not hypot(u, v, n) < LARGEST_SPEED_M_S:
            raise _refuse(_NEAR, "velocity", (u, v, n), LARGEST_SPEED_M_S)
    return message


NEAR_FIELDS = ("x", "y", "z", "radius", "vx", "vy", "vz", "above")
REQUIRED_FIELDS = NEAR_FIELDS[:4]
EXACT_FIELDS = {f"exact_{axis}": axis for axis in "xyz"}
"""FLOAT64 beside an x y z in FLOAT32, which viewers read and which is coarse far from the origin of the frame."""

_POINT_FLOATS = {7: "f4", 8: "f8"}  # PointField.FLOAT32, FLOAT64
_STEP = 9 * 8  # seven numbers, then x y z for viewers; `above` follows where there is an ellipsoid
_LARGEST_STEP = 1 << 16  # bytes of a point


def _our_fields(above: bool = False) -> tuple[tuple[str, int, int, int], ...]:
    """Name, offset, datatype and count of the fields of our points."""
    exact = [(name, 8 * i, 8, 1) for i, name in enumerate((*EXACT_FIELDS, *NEAR_FIELDS[3:7]))]
    exact += [("above", _STEP, 8, 1)] if above else []
    return (*((axis, 56 + 4 * i, 7, 1) for i, axis in enumerate("xyz")), *exact)


def _our_table(above: bool) -> bytes:
    """Our field table, from the number of fields to point_step; it starts aligned to 4."""
    table = bytearray(LITTLE_ENDIAN_HEADER + struct.pack("<I", len(_our_fields(above))))
    for name, *field in _our_fields(above):
        pad(table, 4)
        table += encode_string(name)
        pad(table, 4)
        table += struct.pack("<IBxxxI", *field)
    table += b"\0"  # is_bigendian
    pad(table, 4)
    return bytes(table[len(LITTLE_ENDIAN_HEADER) :]) + struct.pack("<I", _STEP + 8 * above)


_OUR_TABLES = _our_table(above=False), _our_table(above=True)


def encode_near(stamp_ns: int, frame_id: str, rows: Floats) -> bytes:
    """PointCloud2 of `rows` (M, 8): x y z radius [m], vx vy vz [m/s], above [m]; of spheres without `above`."""
    if rows.ndim != 2 or rows.shape[1] != len(NEAR_FIELDS):
        raise WireError(f"{_NEAR}: rows of shape {rows.shape}: expected (M, {len(NEAR_FIELDS)})")
    above = bool(rows[:, 7].any())
    numbers = np.zeros((len(rows), _STEP // 8 + above))
    numbers[:, :7] = rows[:, :7]
    numbers.view("<f4")[:, 14:17] = rows[:, :3]
    if above:
        numbers[:, -1] = rows[:, 7]
    points = numbers.tobytes()
    buffer = bytearray(LITTLE_ENDIAN_HEADER + stamp_bytes(stamp_ns) + aligned_string(frame_id))
    buffer += struct.pack("<II", 1, len(rows)) + _OUR_TABLES[above]  # height, width
    buffer += struct.pack("<II", len(points), len(points)) + points  # row_step, length of data
    return bytes(buffer + b"\x01")  # is_dense


def decode_near(buf: bytes) -> Stamped:
    """Stamp [ns] and rows (M, 8) x y z radius [m], vx vy vz [m/s], above [m] of a PointCloud2.

    FLOAT32 and FLOAT64 fields in any order are understood and others ignored; clouds may be
    organised (height > 1) or padded. `EXACT_FIELDS` take precedence, which a sender need not have. One
    without vx vy vz or above gives 0, and so does such a number that is not finite. A point whose x y z or
    radius is not finite is left out: a sensor marks "no return" that way.
    """
    reader = Reader(buf, _NEAR)
    stamp_ns = reader.stamp()
    reader.take(*reader.numbers("I"))  # frame_id
    height, width = reader.numbers("II")
    if reader.order == "<" and buf.startswith(_OUR_TABLES[0], reader.at):
        reader.at += len(_OUR_TABLES[0])  # at a tenth of the cost of reading it
        kind = _OUR_TYPE
    else:
        fields = []
        for _ in range(*reader.numbers("I")):
            name = reader.text()
            fields.append((name, *reader.numbers("IBxxxI")))
        (big_endian,) = reader.numbers("?", 1)
        (point_step,) = reader.numbers("I")
        kind = _point_type(tuple(fields), ">" if big_endian else "<", point_step)
    row_step, size = reader.numbers("II")
    data_at = reader.at
    reader.take(size + 1)  # data and is_dense
    if height * width:
        if row_step < width * kind.itemsize:
            raise WireError(
                f"{_NEAR}: row_step={row_step}: expected >= {width} x {kind.itemsize} bytes"
            )
        needed = (height - 1) * row_step + width * kind.itemsize
        if size < needed:
            raise WireError(
                f"{_NEAR}: {size} bytes of data: expected {needed} for {height}x{width}"
            )
    with np.errstate(invalid="ignore"):  # of a signalling NaN, which is left out like any other
        if kind is _OUR_TYPE and height == 1:  # at a third of the cost of its columns
            rows = np.zeros((width, len(NEAR_FIELDS)))
            rows[:, :7] = np.ndarray((width, 7), "<f8", buf, data_at, (_STEP, 8))
        else:
            shape, steps = (height, width), (row_step, kind.itemsize)
            points = np.ndarray(shape, kind, buf, data_at, steps).reshape(-1)
            rows = np.zeros((len(points), len(NEAR_FIELDS)))
            for name in kind.names or ():
                rows[:, NEAR_FIELDS.index(name)] = points[name]
    finite = np.isfinite(rows)
    if not finite.all():
        rows[:, 4:][~finite[:, 4:]] = 0.0
        rows = rows[finite[:, :4].all(axis=1)]
    return Stamped(stamp_ns, rows)


@lru_cache(maxsize=64)
def _point_type(
    fields: tuple[tuple[str, int, int, int], ...], order: str, point_step: int
) -> np.dtype[np.void]:
    """Structured dtype that picks the near fields out of one point of `point_step` bytes.

    Each of its `fields` has a name, an offset, a datatype and a number of elements.
    """
    if point_step > _LARGEST_STEP:
        raise WireError(f"{_NEAR}: point_step={point_step}: expected {_LARGEST_STEP} at most")
    known = {name: field for name, *field in fields if name in NEAR_FIELDS}
    known |= {EXACT_FIELDS[name]: field for name, *field in fields if name in EXACT_FIELDS}
    missing = [name for name in REQUIRED_FIELDS if name not in known]
    if missing:
        names = ", ".join(name for name, *_ in fields) or "none"
        raise WireError(f"{_NEAR}: no field {', '.join(missing)} among {names}")
    for name, (offset, datatype, elements) in known.items():
        where = f"{_NEAR}: field {name}"
        if datatype not in _POINT_FLOATS:
            raise WireError(f"{where}: datatype {datatype}: expected 7 (FLOAT32) or 8 (FLOAT64)")
        if elements != 1:
            raise WireError(f"{where}: count={elements}: expected 1")
        if offset + int(_POINT_FLOATS[datatype][1]) > point_step:
            raise WireError(f"{where}: offset {offset}: expected inside point_step={point_step}")
    return np.dtype(
        {
            "names": list(known),
            "formats": [order + _POINT_FLOATS[datatype] for _, datatype, _ in known.values()],
            "offsets": [offset for offset, _, _ in known.values()],
            "itemsize": point_step,
        }
    )


_OUR_TYPE = _point_type(_our_fields(), "<", _STEP)
