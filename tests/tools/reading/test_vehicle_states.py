"""Bags of Crazyswarm, MAVROS, motion capture and PX4 get the verdict of the same flight as our own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_io.mavlink.frames import (
    GeoPoint,
    point_at,
    quaternion_enu_flu_to_ned_frd,
    vector_enu_to_ned,
)
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_tools.options import ReadOptions, TopicPatternError
from ptnsbc_tools.reading.bag_reader import read_recording

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

STORE = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
PX4 = "px4_msgs/msg/VehicleOdometry"
STORE.register(
    typesys.get_types_from_msg(
        "uint64 timestamp\nuint64 timestamp_sample\nuint8 pose_frame\nfloat32[3] position\nfloat32[4] q\n"
        "uint8 velocity_frame\nfloat32[3] velocity\nfloat32[3] angular_velocity\nuint8 reset_counter\n",
        PX4,
    )
)
WALL_NS = 1_700_000_000_000_000_000
STEP = 4  # ticks, as slow as motion capture
HOME = GeoPoint(47.397742, 8.545594, 488.0)


def make(kind: str, **fields):
    return STORE.types[kind](**fields)


def header(t_ns: int, frame: str = "world"):
    stamp = make("builtin_interfaces/msg/Time", sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def point(values, kind: str = "Point"):
    return make(f"geometry_msgs/msg/{kind}", x=values[0], y=values[1], z=values[2])


def turn(q):
    return make("geometry_msgs/msg/Quaternion", x=q[0], y=q[1], z=q[2], w=q[3])


def pose(values):
    return make("geometry_msgs/msg/Pose", position=point(values), orientation=turn(values[3:7]))


def of_pose(t_ns, uav, values):
    return make("geometry_msgs/msg/PoseStamped", header=header(t_ns), pose=pose(values))


def of_transform(t_ns, uav, values):
    moved = make(
        "geometry_msgs/msg/Transform",
        translation=point(values, "Vector3"),
        rotation=turn(values[3:7]),
    )
    one = make(
        "geometry_msgs/msg/TransformStamped",
        header=header(t_ns),
        child_frame_id=f"cf23{uav}",
        transform=moved,
    )
    return make("tf2_msgs/msg/TFMessage", transforms=[one])


def of_px4(t_ns, uav, values):
    nothing = np.zeros(3, np.float32)
    return make(
        PX4,
        timestamp=t_ns // 1000,
        timestamp_sample=t_ns // 1000,
        pose_frame=1,
        position=vector_enu_to_ned(values[:3]).astype(np.float32),
        q=quaternion_enu_flu_to_ned_frd(values[3:7]).astype(np.float32),
        velocity_frame=1,
        velocity=nothing,
        angular_velocity=nothing,
        reset_counter=0,
    )


def of_ned(t_ns, uav, values):
    w, x, y, z = quaternion_enu_flu_to_ned_frd(values[3:7])
    in_ned = np.array([*vector_enu_to_ned(values[:3]), x, y, z, w])
    signs = np.array([1.0, -1.0, -1.0])
    still = np.zeros(36)
    twist = make(
        "geometry_msgs/msg/Twist",
        linear=point(signs * values[7:10], "Vector3"),
        angular=point(signs * values[10:13], "Vector3"),
    )
    return make(
        "nav_msgs/msg/Odometry",
        header=header(t_ns),
        child_frame_id="body",
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose(in_ned), covariance=still),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=still),
    )


def record(path: Path, flown, message, name, *, origins=None, booted_ns=0) -> Path:
    """`name`: the topic of a UAV; `origins`: where its own frame has its zero."""
    writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
    with writer:
        made = {}
        every = next(iter(flown.odometry.values())).t_ns.tolist()
        for k, t_ns in list(enumerate(every))[::STEP]:
            for uav, series in flown.odometry.items():
                values = series.values[k].copy()
                values[:3] -= 0.0 if origins is None else origins[uav]
                at_ns = t_ns + 10**9 * uav if booted_ns else WALL_NS + t_ns
                one, topic = message(at_ns, uav, values), name(uav)
                if topic not in made:
                    kind = one.__msgtype__
                    made[topic] = writer.add_connection(topic, kind, typestore=STORE)
                data = STORE.serialize_cdr(one, one.__msgtype__)
                writer.write(made[topic], WALL_NS + t_ns, data)
    return path


def names(name, uavs) -> list[str]:
    return [",".join(f"{uav}={name(uav)}" for uav in uavs)]


KINDS = {
    "crazyswarm": (of_pose, lambda uav: f"/cf23{uav}/pose", {}),
    "tf": (of_transform, lambda uav: "/tf", {}),
    "px4": (of_px4, lambda uav: f"/px4_0{uav}/fmu/out/vehicle_odometry", {}),
    "ned": (of_ned, lambda uav: f"/name{'abcde'[uav - 1]}/odom", {"frame": "ned"}),
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_verdict(flown, scenario_file, tmp_path, kind):
    message, name, more = KINDS[kind]
    bag = record(tmp_path / "bag", flown, message, name)
    uavs = flown.scenario.uav_ids
    mapped = names((lambda uav: f"/tf:cf23{uav}") if kind == "tf" else name, uavs)
    found = read_recording(bag, ReadOptions(scenario_file, mapped=mapped, **more))
    for uav, series in flown.odometry.items():
        own = found.odometry[uav]
        values = series.values[::STEP]
        assert (own.t_ns - WALL_NS == series.t_ns[::STEP]).all()
        assert own.values[:, :3] == pytest.approx(values[:, :3], abs=1e-5)
        turned = (own.values[:, 3:7] * values[:, 3:7]).sum(axis=1)
        assert np.abs(turned) == pytest.approx(1.0, abs=1e-5)
    one, other = verdict_on(found), verdict_on(flown)
    assert one.verdict == other.verdict == "met"
    assert one.uavs[2].settling_s == pytest.approx(other.uavs[2].settling_s, abs=0.041)


def test_a_pose_gets_the_velocity_from_the_one_before(flown, scenario_file, tmp_path):
    """In the body, as an odometry has it."""
    turned = {
        uav: replace_attitude(series, [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])  # to the left
        for uav, series in flown.odometry.items()
    }
    message, name, _ = KINDS["crazyswarm"]
    bag = record(tmp_path / "bag", replace(flown, odometry=turned), message, name)
    mapped = names(name, flown.scenario.uav_ids)
    own = read_recording(bag, ReadOptions(scenario_file, mapped=mapped)).odometry[2]
    moved = np.diff(own.values[:, :3], axis=0) / (np.diff(own.t_ns)[:, None] * 1e-9)
    assert own.values[1:, 7] == pytest.approx(moved[:, 1], abs=1e-9)
    assert own.values[1:, 8] == pytest.approx(-moved[:, 0], abs=1e-9)


def replace_attitude(series, quaternion):
    values = series.values.copy()
    values[:, 3:7] = quaternion
    return type(series)(series.t_ns, values)


@pytest.mark.parametrize("geodetic", [False, True])
def test_every_vehicle_has_an_origin_of_its_own(flown, scenario_file, tmp_path, geodetic):
    origins = {uav: np.array([3.0 * k, -2.0 * k, 0.5 * k]) for k, uav in enumerate(flown.odometry)}
    message, name, _ = KINDS["px4"]
    bag = record(tmp_path / "bag", flown, message, name, origins=origins)
    told = []
    for uav, place in origins.items():
        at = point_at(place, HOME, 6_371_000.0)
        degrees = f"{at.latitude_deg:.9f}N,{at.longitude_deg:.9f}E,{at.altitude_m}"
        told.append(f"{uav}={degrees if geodetic else ','.join(map(str, place))}")
    mapped = names(name, flown.scenario.uav_ids)
    found = read_recording(bag, ReadOptions(scenario_file, mapped=mapped, origins=told))
    for uav, series in flown.odometry.items():
        expected = pytest.approx(series.values[::STEP, :3], abs=1e-3)
        assert found.odometry[uav].values[:, :3] == expected
    assert verdict_on(found).verdict == "met"


def test_clocks_since_boot_count_by_the_times_of_recording(flown, scenario_file, tmp_path):
    message, name, _ = KINDS["px4"]
    bag = record(tmp_path / "bag", flown, message, name, booted_ns=1)
    mapped = names(name, flown.scenario.uav_ids)
    found = read_recording(bag, ReadOptions(scenario_file, mapped=mapped))
    assert {track.first_ns for track in found.odometry.values()} == {WALL_NS}
    assert verdict_on(found).verdict == "met"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"mapped": ["cf1=/pose"]},
            "topic of a UAV: cf1=/pose: expected N=VALUE with N one of 1, 2",
        ),
        ({"mapped": ["77=/pose"]}, "topic of a UAV: 77=/pose: expected N=VALUE"),
        ({"mapped": ["1=/a,1=/b"]}, r"1=/b: expected N=VALUE .*each once"),
        ({"origins": ["1=3,4"]}, "origin of a UAV: 3,4: expected x,y,z"),
        ({"origins": ["1=47.3,8.5E,4"]}, "latitude, longitude and altitude"),
    ],
)
def test_what_names_no_place_is_refused(flown, scenario_file, tmp_path, options, message):
    bag = record(tmp_path / "bag", flown, *KINDS["crazyswarm"][:2])
    with pytest.raises(TopicPatternError, match=message):
        read_recording(bag, ReadOptions(scenario_file, **options))


def test_words_are_about_the_topics_that_were_named(flown, scenario_file, tmp_path):
    bag = record(tmp_path / "bag", flown, *KINDS["crazyswarm"][:2])
    mapped = ["1=/cf231/pose,2=/tf:cf232"]
    found = read_recording(bag, ReadOptions(scenario_file, odom="/x{n}/odom", mapped=mapped))
    with pytest.raises(Exception, match="no message on /tf:cf232, /x3/odom"):
        verdict_on(found)
