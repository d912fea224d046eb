"""Clouds of near objects: ours against rclpy's serialiser, and those of other drivers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from wire_messages import FRAMES, ROWS, STAMPS, foreign_near, ros_cloud, ros_header, same_bytes

from ptnsbc_io import wire


@given(STAMPS, FRAMES, ROWS)
def test_near_as_rclpy(ros, stamp, frame, rows):
    ours = wire.encode_near(stamp, frame, rows)
    message = ros_cloud(stamp, frame, rows)
    same_bytes(ros, ours, message)
    for buf in (ours, ros.serialize_message(message)):
        decoded = wire.decode_near(buf)
        assert decoded.stamp_ns == stamp
        assert decoded.values.tobytes() == rows.tobytes()


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


def test_wrong_rows():
    with pytest.raises(wire.WireError, match=r"\(2, 6\): expected \(M, 7\)"):
        wire.encode_near(0, "map", np.ones((2, 6)))
