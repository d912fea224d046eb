"""The codec against rclpy's own serialiser, against itself, and against rubbish."""

from __future__ import annotations

import os
import struct

os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ptnsbc_io import wire

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
DECODERS = [
    wire.decode_odometry,
    wire.decode_near,
    wire.decode_velocity,
    wire.decode_wrench,
    wire.decode_header,
    wire.decode_clock,
    wire.peek_stamp,
    wire.peek_sequence_stamp,
]


@pytest.fixture(scope="module")
def ros():
    """rclpy's serialiser, or skip."""
    return pytest.importorskip("rclpy.serialization")


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


def ros_cloud(stamp_ns, frame_id, rows):
    from sensor_msgs.msg import PointCloud2, PointField

    return PointCloud2(
        header=ros_header(stamp_ns, frame_id),
        height=1,
        width=len(rows),
        fields=[
            PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
            for i, name in enumerate(wire.NEAR_FIELDS)
        ],
        point_step=28,
        row_step=28 * len(rows),
        data=rows.astype("<f4").tobytes(),
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


@given(STAMPS, FRAMES, ROWS)
def test_near_as_rclpy(ros, stamp, frame, rows):
    ours = wire.encode_near(stamp, frame, rows)
    message = ros_cloud(stamp, frame, rows)
    same_bytes(ros, ours, message)
    for buf in (ours, ros.serialize_message(message)):
        decoded = wire.decode_near(buf)
        assert decoded.stamp_ns == stamp
        assert decoded.values.tobytes() == rows.tobytes()


def test_peek_sequence_stamp(ros):
    from visualization_msgs.msg import Marker, MarkerArray

    markers = MarkerArray(markers=[Marker(header=ros_header(12_000_000_034, "map"), ns="a")])
    assert wire.peek_sequence_stamp(ros.serialize_message(markers)) == 12_000_000_034
    assert wire.peek_sequence_stamp(ros.serialize_message(MarkerArray())) is None


def test_near_without_velocities():
    assert wire.decode_near(foreign_near()).values.tolist() == [
        [0, 1, 2, 3, 0, 0, 0],
        [4, 5, 6, 7, 0, 0, 0],
    ]


class TestSensorsOwnCloud:
    """A depth sensor's driver lays its cloud out as it likes."""

    @staticmethod
    def cloud(dtype, points, *, height=1, gap=0, big=False, count=1):
        from sensor_msgs.msg import PointCloud2, PointField

        kinds = {"f4": 7, "f8": 8, "u1": 2, "u4": 6}
        fields = [
            PointField(name=n, offset=o, datatype=kinds[t.str[1:]], count=count)
            for n, (t, o) in dtype.fields.items()
        ]
        lines = np.asarray(points, dtype).reshape(height, -1)
        step = lines.shape[1] * dtype.itemsize + gap
        data = b"".join(line.tobytes() + bytes(gap) for line in lines)
        return PointCloud2(
            header=ros_header(1, "cam"), height=height, width=lines.shape[1], fields=fields,
            is_bigendian=big, point_step=dtype.itemsize, row_step=step, data=data,
        )  # fmt: skip

    def decode(self, ros, dtype, points, **more):
        return wire.decode_near(ros.serialize_message(self.cloud(dtype, points, **more))).values

    def test_other_order_double_and_extra_fields(self, ros):
        dtype = np.dtype(
            [("rgb", "<u4"), ("radius", "<f8"), ("z", "<f4"), ("y", "<f4"), ("x", "<f8")]
        )
        rows = self.decode(ros, dtype, [(9, 0.5, 3, 2, 1)])
        assert rows.tolist() == [[1, 2, 3, 0.5, 0, 0, 0]]

    def test_organised_with_padding_and_big_endian(self, ros):
        dtype = np.dtype([(n, ">f4") for n in ("x", "y", "z", "radius")])
        points = [(i, 2 * i, 3 * i, 1) for i in range(6)]
        rows = self.decode(ros, dtype, points, height=2, gap=5, big=True)
        assert rows[:, :4].tolist() == [list(p) for p in points]

    def test_our_fields_organised(self, ros):
        dtype = np.dtype([(n, "<f4") for n in wire.NEAR_FIELDS])
        points = [tuple(range(i, i + 7)) for i in range(6)]
        rows = self.decode(ros, dtype, points, height=3, gap=4)
        assert rows.tolist() == [list(p) for p in points]

    def test_points_without_return_are_left_out(self, ros):
        dtype = np.dtype([(n, "<f4") for n in wire.NEAR_FIELDS])
        nan = float("nan")
        points = [(1, 2, 3, 1, 0, 0, 0), (nan, nan, nan, 1, 0, 0, 0), (4, 5, 6, 1, nan, 1, 2)]
        rows = self.decode(ros, dtype, points)
        assert rows.tolist() == [[1, 2, 3, 1, 0, 0, 0], [4, 5, 6, 1, 0, 1, 2]]

    @pytest.mark.parametrize("missing", ["x", "y", "z", "radius"])
    def test_missing_field(self, ros, missing):
        dtype = np.dtype([(n, "<f4") for n in wire.NEAR_FIELDS if n != missing])
        with pytest.raises(wire.WireError, match=f"no field {missing} among"):
            self.decode(ros, dtype, np.zeros(2, dtype))

    def test_integer_field(self, ros):
        dtype = np.dtype([("x", "u1"), ("y", "<f4"), ("z", "<f4"), ("radius", "<f4")])
        with pytest.raises(wire.WireError, match="field x: datatype 2: expected 7"):
            self.decode(ros, dtype, np.zeros(1, dtype))

    def test_count(self, ros):
        dtype = np.dtype([(n, "<f4") for n in wire.NEAR_FIELDS])
        with pytest.raises(wire.WireError, match="count=3: expected 1"):
            self.decode(ros, dtype, np.zeros(1, dtype), count=3)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"width": 3}, "row_step=56: expected >= 3 x 28"),
            ({"height": 2}, "56 bytes of data: expected 112 for 2x2"),
            ({"point_step": 20}, "expected inside point_step=20"),
            ({"point_step": 0, "row_step": 0, "height": 2**31, "width": 2**31}, "point_step=0"),
        ],
    )
    def test_sizes_that_contradict(self, ros, change, message):
        cloud = ros_cloud(0, "m", np.zeros((2, 7)))
        for name, value in change.items():
            setattr(cloud, name, value)
        with pytest.raises(wire.WireError, match=message):
            wire.decode_near(ros.serialize_message(cloud))


def foreign_near():
    """A cloud without velocities, written by hand: needs no rclpy."""
    buf = struct.pack("<4xiII4xIII", 1, 2, 1, 1, 2, 4)
    for i, name in enumerate((b"x", b"y", b"z", b"radius")):
        buf += struct.pack(f"<I{len(name) + 1}s", len(name) + 1, name)
        buf += bytes(-len(buf) % 4) + struct.pack("<IBxxxI", 4 * i, 7, 1)
    buf += struct.pack("<BxxxIII8f?", 0, 16, 32, 32, *range(8), True)
    return b"\0\1" + buf[2:]


def samples():
    odom = wire.OdometryTemplate("map", "uav1").encode(3, np.ones(13))
    six = wire.WrenchTemplate("uav1").encode(3, np.ones(6))
    near = wire.encode_near(3, "map", np.ones((2, 7)))
    return [
        odom,
        six,
        near,
        wire.HeaderTemplate("leg 1").encode(3),
        wire.ClockTemplate().encode(3),
        foreign_near(),
    ]


@given(st.one_of(st.binary(max_size=200), st.sampled_from(samples())), st.data())
@settings(max_examples=500)
def test_rubbish_raises_only_wire_errors(buf, data):
    broken = bytearray(buf)
    for at in data.draw(st.lists(st.integers(0, max(len(buf) - 1, 0)), max_size=4)):
        if broken:
            broken[at] = data.draw(st.integers(0, 255))
    cut = bytes(broken[: data.draw(st.integers(0, len(broken)))])
    for decode in DECODERS:
        try:
            decode(cut)
        except wire.WireError as error:
            assert "expected" in str(error) or "no field" in str(error)


@pytest.mark.parametrize(
    ("decode", "buf"),
    [
        (wire.decode_odometry, samples()[0]),
        (wire.decode_wrench, samples()[1]),
        (wire.decode_near, samples()[2]),
        (wire.decode_header, samples()[3]),
        (wire.decode_clock, samples()[4]),
        (wire.decode_near, samples()[5]),
    ],
)
def test_every_cut_is_an_error(decode, buf):
    decode(buf)
    decode(buf + b"\0\0")  # a transport may round a message up
    for size in range(len(buf)):
        with pytest.raises(wire.WireError, match="expected"):
            decode(buf[:size])


def test_unknown_encapsulation():
    with pytest.raises(wire.WireError, match="encapsulation 0006: expected 0001 or 0000"):
        wire.decode_odometry(b"\x00\x06" + samples()[0][2:])


@pytest.mark.parametrize("values", [np.ones(12), np.ones((13, 2)), np.ones(0)])
def test_wrong_vector(values):
    with pytest.raises(wire.WireError, match=r"expected \(13,\)"):
        wire.OdometryTemplate("map", "uav1").encode(0, values)


def test_wrong_rows():
    with pytest.raises(wire.WireError, match=r"\(2, 6\): expected \(M, 7\)"):
        wire.encode_near(0, "map", np.ones((2, 6)))


def test_stamp_beyond_the_wire():
    with pytest.raises(wire.WireError, match="expected seconds within 32 bits"):
        wire.HeaderTemplate("x").encode(2**31 * 10**9)


def test_string_with_nul():
    with pytest.raises(wire.WireError, match="expected no NUL"):
        wire.HeaderTemplate("a\0b")
