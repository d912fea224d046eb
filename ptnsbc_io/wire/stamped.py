"""TwistStamped, WrenchStamped, Header and Clock, and the stamp of any stamped message."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

from ptnsbc_io.wire.cdr import (
    LITTLE_ENDIAN_HEADER,
    NANOSECONDS,
    Floats,
    Stamped,
    align,
    byte_order,
    float_bytes,
    header_bytes,
    pad,
    read_stamp,
    require,
    skip_string,
    stamp_bytes,
    string_at,
    write_stamp,
)

_VELOCITY = "geometry_msgs/TwistStamped"
_WRENCH = "geometry_msgs/WrenchStamped"
_HEADER = "std_msgs/Header"
_CLOCK = "rosgraph_msgs/Clock"
_VECTOR_PAIR = 6 * 8
_LITTLE = LITTLE_ENDIAN_HEADER[:2]
_STAMP = struct.Struct("<iI")
_START = struct.Struct("<iII")  # stamp, length of frame_id
_FRAME_AT = 12  # after the encapsulation header and the stamp


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
        read_stamp(buf, order, 4, _HEADER), string_at(buf, order, 12, f"{_HEADER} frame_id")
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
    values_at = align(skip_string(buf, order, 12, what), 8)
    require(buf, values_at + _VECTOR_PAIR, what)
    values = np.frombuffer(buf, f"{order}f8", 6, values_at)
    return Stamped(stamp_ns, values.astype(np.float64))
