"""nav_msgs/Odometry as a flat vector of 13: the state message of the formation.

    position x y z [m] | quaternion x y z w [-]
    | linear velocity x y z [m/s] | angular velocity x y z [rad/s]

Position and attitude are in `header.frame_id`, velocities in `child_frame_id`, as in the message.
Covariances are sent as zeros (unknown) and skipped on receipt.
"""

from __future__ import annotations

import struct

import numpy as np

from ptnsbc_io.wire.cdr import (
    LITTLE_ENDIAN_HEADER,
    NANOSECONDS,
    Floats,
    Stamped,
    align,
    byte_order,
    encode_string,
    float_bytes,
    header_bytes,
    pad,
    read_stamp,
    require,
    skip_string,
    stamp_bytes,
)

ODOMETRY_SIZE = 13

_WHAT = "nav_msgs/Odometry"
_FLOAT64 = {order: np.dtype(f"{order}f8") for order in "<>"}
_COVARIANCE = 36 * 8
_POSE = 7 * 8
_TWIST = 6 * 8
_TWIST_AT = _POSE + _COVARIANCE
_NUMBERS = _TWIST_AT + _TWIST + _COVARIANCE
_LITTLE = LITTLE_ENDIAN_HEADER[:2]
_START = struct.Struct("<iII")  # stamp, length of frame_id
_FRAMES_AT = 12  # after the encapsulation header and the stamp
_UNKNOWN = bytes(_COVARIANCE)
_LENGTH = struct.Struct("<I")


class OdometryTemplate:
    """Encoder of Odometry messages with fixed frames, assembled from prebuilt parts.

    Building the message object and serialising it costs rclpy 31 µs; this costs about one.
    """

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        buffer = header_bytes(frame_id)
        pad(buffer, 4)
        buffer += encode_string(child_frame_id)
        pad(buffer, 8)
        self._frames = bytes(buffer[_FRAMES_AT:])

    def encode(self, stamp_ns: int, odom13: Floats) -> bytes:
        """The message of `odom13` (13,) at `stamp_ns` [ns]."""
        numbers = float_bytes(odom13, ODOMETRY_SIZE, _WHAT)
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
                numbers += buf[twist_at : twist_at + _TWIST]
                stamp_ns = seconds * NANOSECONDS + nanoseconds
                return Stamped(stamp_ns, np.frombuffer(numbers, np.float64))
    return _decode(buf)


def _decode(buf: bytes) -> Stamped:
    order = byte_order(buf, _WHAT)
    stamp_ns = read_stamp(buf, order, 4, _WHAT)
    child_at = align(skip_string(buf, order, 12, _WHAT), 4)
    pose_at = align(skip_string(buf, order, child_at, _WHAT), 8)
    require(buf, pose_at + _NUMBERS, _WHAT)
    twist_at = pose_at + _TWIST_AT
    numbers = buf[pose_at : pose_at + _POSE] + buf[twist_at : twist_at + _TWIST]
    return Stamped(stamp_ns, np.frombuffer(numbers, _FLOAT64[order]).astype(np.float64))
