"""Messages for the tests of ptnsbc_io.wire: random values, and the same messages made by rclpy."""

from __future__ import annotations

import struct

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

STAMPS = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
FRAMES = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
NUMBERS = st.floats(width=64, allow_nan=False)
ODOMS = arrays(np.float64, 13, elements=NUMBERS)
SIXES = arrays(np.float64, 6, elements=NUMBERS)
ROWS = arrays(
    np.float64,
    st.tuples(st.integers(0, 6), st.just(7)),
    elements=st.floats(width=32, allow_nan=False, allow_infinity=False),
)


def ros_time(stamp_ns):
    from builtin_interfaces.msg import Time

    sec, nanosec = divmod(stamp_ns, 10**9)
    return Time(sec=sec, nanosec=nanosec)


def ros_header(stamp_ns, frame_id):
    from std_msgs.msg import Header

    return Header(stamp=ros_time(stamp_ns), frame_id=frame_id)


def ros_odometry(stamp_ns, frame_id, child, v):
    from nav_msgs.msg import Odometry

    message = Odometry(header=ros_header(stamp_ns, frame_id), child_frame_id=child)
    pose, twist = message.pose.pose, message.twist.twist
    for target, names, numbers in (
        (pose.position, "xyz", v[0:3]),
        (pose.orientation, "xyzw", v[3:7]),
        (twist.linear, "xyz", v[7:10]),
        (twist.angular, "xyz", v[10:13]),
    ):
        for name, number in zip(names, numbers, strict=True):
            setattr(target, name, float(number))
    return message


def ros_six(kind, stamp_ns, frame_id, v):
    from geometry_msgs.msg import TwistStamped, Vector3, WrenchStamped

    first, second = (
        Vector3(**dict(zip("xyz", map(float, v[:3]), strict=True))),
        Vector3(**dict(zip("xyz", map(float, v[3:]), strict=True))),
    )
    if kind == "twist":
        message = TwistStamped(header=ros_header(stamp_ns, frame_id))
        message.twist.linear, message.twist.angular = first, second
    else:
        message = WrenchStamped(header=ros_header(stamp_ns, frame_id))
        message.wrench.force, message.wrench.torque = first, second
    return message


def ros_cloud(stamp_ns, frame_id, points):
    """A cloud of structured points, as their dtype lays them out."""
    from sensor_msgs.msg import PointCloud2, PointField

    kinds = {"<f4": PointField.FLOAT32, "<f8": PointField.FLOAT64}
    size = points.dtype.itemsize
    return PointCloud2(
        header=ros_header(stamp_ns, frame_id),
        height=1,
        width=len(points),
        fields=[
            PointField(name=name, offset=offset, datatype=kinds[kind.str], count=1)
            for name, (kind, offset) in points.dtype.fields.items()
        ],
        point_step=size,
        row_step=size * len(points),
        data=points.tobytes(),
        is_dense=True,
    )


def same_bytes(ros, ours, message):
    """Our bytes are rclpy's, and zero in the alignment gaps where rclpy leaves old memory.

    A byte of ours may be zero where theirs is not; that it is a gap and no field shows in that
    rclpy reads the same message out of ours.
    """
    theirs = ros.serialize_message(message)
    assert len(ours) == len(theirs)
    for ours_byte, theirs_byte in zip(ours, theirs, strict=True):
        assert ours_byte in (theirs_byte, 0)
    assert ros.deserialize_message(ours, type(message)) == message


def foreign_near():
    """A cloud without velocities, written by hand: needs no rclpy."""
    buf = struct.pack("<4xiII4xIII", 1, 2, 1, 1, 2, 4)
    for i, name in enumerate((b"x", b"y", b"z", b"radius")):
        buf += struct.pack(f"<I{len(name) + 1}s", len(name) + 1, name)
        buf += bytes(-len(buf) % 4) + struct.pack("<IBxxxI", 4 * i, 7, 1)
    buf += struct.pack("<BxxxIII8f?", 0, 16, 32, 32, *range(8), True)
    return b"\0\1" + buf[2:]
