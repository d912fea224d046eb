"""TwistStamped, WrenchStamped, Header and Clock against rclpy's serialiser."""

from __future__ import annotations

import pytest
from hypothesis import given
from wire_messages import FRAMES, SIXES, STAMPS, ros_header, ros_six, ros_time, same_bytes

from ptnsbc_io import wire


@pytest.mark.parametrize("kind", ["twist", "wrench"])
@given(stamp=STAMPS, frame=FRAMES, values=SIXES)
def test_six_as_rclpy(ros, kind, stamp, frame, values):
    template, decode = {
        "twist": (wire.VelocityTemplate, wire.decode_velocity),
        "wrench": (wire.WrenchTemplate, wire.decode_wrench),
    }[kind]
    message = ros_six(kind, stamp, frame, values)
    ours = template(frame).encode(stamp, values)
    same_bytes(ros, ours, message)
    decoded = decode(ros.serialize_message(message))
    assert (decoded.stamp_ns, decoded.values.tobytes()) == (stamp, values.tobytes())
    assert decode(ours).values.tobytes() == values.tobytes()
    assert wire.peek_stamp(ours) == stamp


@given(STAMPS, FRAMES)
def test_header_as_rclpy(ros, stamp, frame):
    message = ros_header(stamp, frame)
    ours = wire.HeaderTemplate(frame).encode(stamp)
    assert ours == ros.serialize_message(message)
    assert wire.decode_header(ours) == (stamp, frame)


@given(STAMPS)
def test_clock_as_rclpy(ros, stamp):
    from rosgraph_msgs.msg import Clock

    ours = wire.ClockTemplate().encode(stamp)
    assert ours == ros.serialize_message(Clock(clock=ros_time(stamp)))
    assert wire.decode_clock(ours) == stamp


def test_peek_sequence_stamp(ros):
    from visualization_msgs.msg import Marker, MarkerArray

    markers = MarkerArray(markers=[Marker(header=ros_header(12_000_000_034, "map"), ns="a")])
    assert wire.peek_sequence_stamp(ros.serialize_message(markers)) == 12_000_000_034
    assert wire.peek_sequence_stamp(ros.serialize_message(MarkerArray())) is None
