"""tf2_msgs/TFMessage from an Odometry: the pose of the body frame in the world frame.

Encoded here because tf2_msgs has no wheel: so bags hold /tf without it.
"""

from __future__ import annotations

import struct

from ptnsbc_io.wire.cdr import (
    LITTLE_ENDIAN_HEADER,
    align,
    byte_order,
    encode_string,
    float_bytes,
    pad,
    skip_string,
    split_stamp,
    string_at,
)
from ptnsbc_io.wire.odometry import decode_odometry

_POSE = 7  # position x y z, quaternion x y z w: in Odometry and in Transform in this order
_WHAT = "nav_msgs/Odometry"


def transform_of(odometry: bytes) -> bytes | None:
    """A TFMessage with one transform, `header.frame_id` to `child_frame_id` of a serialised Odometry.

    None when the Odometry does not name both frames. WireError when it is not an Odometry.
    """
    state = decode_odometry(odometry)
    order = byte_order(odometry, _WHAT)
    parent = string_at(odometry, order, 12, f"{_WHAT} frame_id")
    child_at = align(skip_string(odometry, order, 12, _WHAT), 4)
    child = string_at(odometry, order, child_at, f"{_WHAT} child_frame_id")
    if not parent or not child:
        return None
    out = bytearray(LITTLE_ENDIAN_HEADER)
    out += struct.pack("<IiI", 1, *split_stamp(state.stamp_ns))
    out += encode_string(parent)
    pad(out, 4)
    out += encode_string(child)
    pad(out, 8)
    out += float_bytes(state.values[:_POSE], _POSE, _WHAT)
    return bytes(out)
