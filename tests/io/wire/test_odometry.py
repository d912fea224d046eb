"""Odometry against rclpy's serialiser and against itself."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from wire_messages import FRAMES, ODOMS, STAMPS, ros_odometry, same_bytes

from ptnsbc_io import wire


@given(STAMPS, FRAMES, FRAMES, ODOMS)
def test_odometry_as_rclpy(ros, stamp, frame, child, odom):
    ours = wire.OdometryTemplate(frame, child).encode(stamp, odom)
    message = ros_odometry(stamp, frame, child, odom)
    same_bytes(ros, ours, message)
    decoded = wire.decode_odometry(ros.serialize_message(message))
    assert decoded.stamp_ns == stamp
    assert decoded.values.tobytes() == odom.tobytes()


def test_odometry_skips_covariances(ros):
    message = ros_odometry(5, "map", "uav1", np.arange(13.0))
    message.pose.covariance[:] = 1e9
    message.twist.covariance[:] = -1e9
    assert wire.decode_odometry(ros.serialize_message(message)).values.tolist() == list(range(13))


@given(STAMPS, FRAMES, FRAMES, ODOMS)
def test_odometry_round_trip(stamp, frame, child, odom):
    decoded = wire.decode_odometry(wire.OdometryTemplate(frame, child).encode(stamp, odom))
    assert decoded.stamp_ns == stamp
    assert decoded.values.tobytes() == odom.tobytes()
    decoded.values[0] = 1.0  # the caller owns the array


def test_template_forgets_the_last_message():
    template = wire.OdometryTemplate("map", "uav1")
    first = template.encode(1, np.ones(13))
    template.encode(2, np.full(13, 2.0))
    assert template.encode(1, np.ones(13)) == first


def test_odometry_big_endian():
    frames = struct.pack(">iI", 7, 9) + struct.pack(">I", 4) + b"map\0" + struct.pack(">I", 1)
    body = frames + bytes(8 - (len(frames) + 1) % 8 + 1)
    numbers = struct.pack(">7d288x6d288x", *range(13))
    decoded = wire.decode_odometry(b"\0\0\0\0" + body + numbers)
    assert decoded.stamp_ns == 7_000_000_009
    assert decoded.values.tolist() == list(range(13))
    assert decoded.values.dtype == np.float64


@pytest.mark.parametrize("values", [np.ones(12), np.ones((13, 2)), np.ones(0)])
def test_wrong_vector(values):
    with pytest.raises(wire.WireError, match=r"expected \(13,\)"):
        wire.OdometryTemplate("map", "uav1").encode(0, values)
