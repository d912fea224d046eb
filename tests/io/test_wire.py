"""Messages against rclpy's serialiser and against themselves, and what one from outside must satisfy."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from wire_messages import (
    FRAMES,
    ODOMS,
    ROWS,
    SIXES,
    STAMPS,
    foreign_near,
    ros_cloud,
    ros_header,
    ros_odometry,
    ros_six,
    ros_time,
    same_bytes,
)

from ptnsbc_io import wire
from ptnsbc_io.wire import WireError, decode_diagnostics


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

    ours = wire.encode_clock(stamp)
    assert ours == ros.serialize_message(Clock(clock=ros_time(stamp)))
    assert wire.peek_stamp(ours) == stamp


def test_peek_sequence_stamp(ros):
    from visualization_msgs.msg import Marker, MarkerArray

    markers = MarkerArray(markers=[Marker(header=ros_header(12_000_000_034, "map"), ns="a")])
    assert wire.peek_sequence_stamp(ros.serialize_message(markers)) == 12_000_000_034
    assert wire.peek_sequence_stamp(ros.serialize_message(MarkerArray())) is None


def test_what_a_node_writes_is_read() -> None:
    pytest.importorskip("rclpy")
    pytest.importorskip("diagnostic_msgs")
    from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics

    values = {"ready": "true", "ä": "", "saturated_s": "0.700"}
    data = diagnostics(1_500_000_000, "uav3: planner", DiagnosticLevel.WARN, "holding", values)
    found = decode_diagnostics(data)
    assert found.stamp_ns == 1_500_000_000
    assert found.statuses[0] == ("uav3: planner", 1, "holding", values)


def test_a_cut_message_is_an_error_in_words() -> None:
    pytest.importorskip("rclpy")
    from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics

    data = diagnostics(0, "uav3: planner", DiagnosticLevel.OK, "", {"ready": "true"})
    for size in range(4, len(data)):
        with pytest.raises(WireError):
            decode_diagnostics(data[:size])


NAMES = ("map", "uav3/base_link")


def body(at=None, value=0.0):
    values = np.zeros(13)
    values[6] = 1.0
    if at is not None:
        values[at] = value
    return values


def odometry(values, frames=NAMES):
    return wire.OdometryTemplate(*frames).encode(7, values)


@pytest.mark.parametrize("decode", [wire.OdometryDecoder(), wire.OdometryDecoder(*NAMES)])
def test_a_possible_state_is_what_was_sent(decode):
    values = np.array([-1e3, 2e3, 50.0, 0.5, 0.5, -0.5, 0.5, 30.0, -30.0, 5.0, 6.0, 6.0, -6.0])
    stamp_ns, found = decode(odometry(values))
    assert stamp_ns == 7
    assert found.tobytes() == values.tobytes()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e308, -1e7])
def test_no_number_of_a_state_may_be_impossible(value):
    for at in range(13):
        with pytest.raises(wire.WireError, match="expected"):
            wire.OdometryDecoder()(odometry(body(at, value)))


@pytest.mark.parametrize("turn", [0.0, 0.9, 1.1, 2.0])
def test_a_quaternion_has_norm_one(turn):
    with pytest.raises(wire.WireError, match=r"quaternion of norm .*: expected 1"):
        wire.OdometryDecoder()(odometry(body(6, turn)))


@pytest.mark.parametrize(
    "frames", [("odom", NAMES[1]), ("map", "uav2/base_link"), ("map", ""), ("map", "uav3")]
)
def test_a_neighbour_names_its_frames(frames):
    with pytest.raises(wire.WireError, match=r"expected 'map' and 'uav3/base_link'"):
        wire.OdometryDecoder(*NAMES)(odometry(body(), frames))
    assert wire.OdometryDecoder()(odometry(body(), frames)).stamp_ns == 7


def test_frames_are_compared_by_name_where_the_gaps_hold_old_memory():
    data = bytearray(odometry(body(), ("map", "uav33/base_link")))
    gap = data.index(b"base_link\0") + len(b"base_link\0")
    assert data[gap] == 0
    assert wire.OdometryDecoder("map", "uav33/base_link")(bytes(data)).stamp_ns == 7
    aligned = odometry(body(), ("world", NAMES[1]))
    data = bytearray(aligned)
    gap = data.index(b"world\0") + 6
    assert data[gap : gap + 2] == bytes(2)
    data[gap : gap + 2] = b"\xab\xcd"
    assert wire.OdometryDecoder("world", NAMES[1])(bytes(data)).stamp_ns == 7


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e308, -1e7])
def test_no_number_of_a_setpoint_may_be_impossible(value):
    for at in range(6):
        values = np.zeros(6)
        values[at] = value
        with pytest.raises(wire.WireError, match="expected"):
            wire.checked_wrench(wire.WrenchTemplate("x").encode(0, values))
        with pytest.raises(wire.WireError, match="expected"):
            wire.checked_velocity(wire.VelocityTemplate("x").encode(0, values))


def near(rows):
    return wire.encode_near(0, "map", np.asarray(rows, dtype=float).reshape(-1, 8))


def test_near_objects_that_can_be():
    assert wire.checked_near(near([])).values.shape == (0, 8)
    rows = np.ones((40, 8))
    assert wire.checked_near(near(rows)).values.tobytes() == rows.tobytes()
    rows[3, 0] = np.nan  # "no return"
    assert len(wire.checked_near(near(rows)).values) == 39


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([[0, 0, 0, -1, 0, 0, 0, 0]], "radius -1 m: expected 0 or more"),
        (
            [[0, 0, 0, 1, 0, 0, 0, 0], [1e9, 0, 0, 1, 0, 0, 0, 0]],
            "position 1e\\+09, 0, 0: expected finite",
        ),
        ([[0, 0, 0, 1, 1e5, 0, 0, 0]], "velocity 100000, 0, 0: .*below 1000"),
        ([[0, 0, 0, 1, 0, 0, 0, -1]], "above -1 m: expected 0 or more"),
        (np.ones((1025, 8)), "1025 objects: expected at most 1024"),
    ],
)
def test_near_objects_that_cannot_be(rows, words):
    with pytest.raises(wire.WireError, match=words):
        wire.checked_near(near(rows))


def exact(above: bool) -> np.dtype:
    """Our points; those of spheres have no field `above`."""
    return np.dtype(
        {
            "names": (*"xyz", *wire.EXACT_FIELDS, *wire.NEAR_FIELDS[3 : 7 + above]),
            "formats": ["<f4"] * 3 + ["<f8"] * (7 + above),
            "offsets": [56, 60, 64, *range(0, 56, 8), *([72] if above else ())],
            "itemsize": 72 + 8 * above,
        }
    )


COARSE = np.dtype([(name, "<f4") for name in wire.NEAR_FIELDS[:7]])
"""As older bags and other programs have it."""


def of_spheres(rows):
    return np.column_stack((rows, np.zeros(len(rows))))


@pytest.mark.parametrize("above", [0.0, 0.7])
@given(STAMPS, FRAMES, ROWS)
def test_near_as_rclpy(ros, above, stamp, frame, rows):
    rows = of_spheres(rows + 1e5 + 1e-9)
    rows[::2, 7] = above
    kind = exact(bool(rows[:, 7].any()))
    points = np.zeros(len(rows), kind)
    for name, column in zip(kind.names, [0, 1, 2, *range(len(kind.names) - 3)], strict=True):
        points[name] = rows[:, column]
    ours, message = wire.encode_near(stamp, frame, rows), ros_cloud(stamp, frame, points)
    same_bytes(ros, ours, message)
    for buf in (ours, ros.serialize_message(message)):
        decoded = wire.decode_near(buf)
        assert decoded.stamp_ns == stamp
        assert decoded.values.tobytes() == rows.tobytes()


def test_near_objects_in_the_frame_of_a_body_are_refused():
    """They were taken for places in the world."""
    cloud = wire.encode_near(0, "uav3/base_link", np.ones((1, 8)))
    with pytest.raises(wire.WireError, match="frame 'uav3/base_link': expected"):
        wire.checked_near(cloud)


@given(STAMPS, FRAMES, ROWS)
def test_near_of_an_older_bag(ros, stamp, frame, rows):
    points = np.array([tuple(row) for row in rows.tolist()], COARSE)
    decoded = wire.decode_near(ros.serialize_message(ros_cloud(stamp, frame, points)))
    assert decoded.values.tobytes() == of_spheres(rows).tobytes()


def test_near_without_velocities():
    assert wire.decode_near(foreign_near()).values.tolist() == [
        [0, 1, 2, 3, 0, 0, 0, 0],
        [4, 5, 6, 7, 0, 0, 0, 0],
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
        assert rows.tolist() == [[1, 2, 3, 0.5, 0, 0, 0, 0]]

    def test_organised_with_padding_and_big_endian(self, ros):
        dtype = np.dtype([(n, ">f4") for n in ("x", "y", "z", "radius")])
        points = [(i, 2 * i, 3 * i, 1) for i in range(6)]
        rows = self.decode(ros, dtype, points, height=2, gap=5, big=True)
        assert rows[:, :4].tolist() == [list(p) for p in points]

    def test_our_fields_organised(self, ros):
        points = [tuple(range(i, i + 7)) for i in range(6)]
        rows = self.decode(ros, COARSE, points, height=3, gap=4)
        assert rows.tolist() == [[*p, 0] for p in points]

    def test_points_without_return_are_left_out(self, ros):
        nan = float("nan")
        points = [(1, 2, 3, 1, 0, 0, 0), (nan, nan, nan, 1, 0, 0, 0), (4, 5, 6, 1, nan, 1, 2)]
        rows = self.decode(ros, COARSE, points)
        assert rows.tolist() == [[1, 2, 3, 1, 0, 0, 0, 0], [4, 5, 6, 1, 0, 1, 2, 0]]

    @pytest.mark.parametrize("missing", ["x", "y", "z", "radius"])
    def test_missing_field(self, ros, missing):
        dtype = np.dtype([(n, "<f4") for n in wire.NEAR_FIELDS[:7] if n != missing])
        with pytest.raises(wire.WireError, match=f"no field {missing} among"):
            self.decode(ros, dtype, np.zeros(2, dtype))

    def test_integer_field(self, ros):
        dtype = np.dtype([("x", "u1"), ("y", "<f4"), ("z", "<f4"), ("radius", "<f4")])
        with pytest.raises(wire.WireError, match="field x: datatype 2: expected 7"):
            self.decode(ros, dtype, np.zeros(1, dtype))

    def test_count(self, ros):
        with pytest.raises(wire.WireError, match="count=3: expected 1"):
            self.decode(ros, COARSE, np.zeros(1, COARSE), count=3)

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
        cloud = ros_cloud(0, "m", np.zeros(2, COARSE))
        for name, value in change.items():
            setattr(cloud, name, value)
        with pytest.raises(wire.WireError, match=message):
            wire.decode_near(ros.serialize_message(cloud))


def test_wrong_rows():
    with pytest.raises(wire.WireError, match=r"\(2, 6\): expected \(M, 8\)"):
        wire.encode_near(0, "map", np.ones((2, 6)))


def test_poses_and_transforms_as_rclpy(ros):
    from geometry_msgs.msg import PoseStamped, TransformStamped
    from tf2_msgs.msg import TFMessage

    pose = PoseStamped(header=ros_header(5, "world"))
    pose.pose.position.y, pose.pose.orientation.w = 2.0, 0.5
    message = wire.decode_pose(ros.serialize_message(pose))
    assert (message.stamp_ns, message.values.tolist()) == (5, [0, 2, 0, 0, 0, 0, 0.5])
    frames = TFMessage()
    for stamp, name in enumerate(("base", "cf231")):
        one = TransformStamped(header=ros_header(stamp, "world"), child_frame_id=name)
        one.transform.translation.z = 3.0
        frames.transforms.append(one)
    data = ros.serialize_message(frames)
    message = wire.decode_transform(data, "cf231")
    assert (message.stamp_ns, message.values.tolist()) == (1, [0, 0, 3, 0, 0, 0, 1])
    assert wire.decode_transform(data, "cf5") is None
    with pytest.raises(WireError, match="cut"):
        wire.decode_transform(data[:-8], "cf231")
