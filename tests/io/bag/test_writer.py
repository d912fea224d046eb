"""The written bag as an independent reader (rosbags) sees it, and the same bytes every time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType

from ptnsbc_io import wire
from ptnsbc_io.bag import BagError, BagWriter, declare, read_bag

TOPICS = (
    declare("/uav1/odom", "nav_msgs/msg/Odometry", reliable=False, depth=1),
    declare("/uav1/near", "sensor_msgs/msg/PointCloud2", reliable=False, depth=1),
    declare("/uav1/setpoint/velocity", "geometry_msgs/msg/TwistStamped"),
    declare("/uav1/setpoint/wrench", "geometry_msgs/msg/WrenchStamped"),
    declare("/formation/epoch", "std_msgs/msg/Header", latched=True, depth=1),
    declare("/clock", "rosgraph_msgs/msg/Clock"),
    declare("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
    declare("/formation/markers", "visualization_msgs/msg/MarkerArray"),
    declare("/tf", "tf2_msgs/msg/TFMessage"),
)
START_NS = 5_000_000_000
TICKS = 20


def write_all(writer: BagWriter) -> None:
    odom = wire.OdometryTemplate("map", "uav1")
    velocity, wrench = wire.VelocityTemplate("map"), wire.WrenchTemplate("uav1")
    writer.write("/formation/epoch", START_NS, wire.HeaderTemplate("leg 1").encode(START_NS))
    for k in range(TICKS):
        stamp = START_NS + k * 10_000_000
        writer.write("/uav1/odom", stamp, odom.encode(stamp, np.arange(13.0) + k))
        writer.write("/uav1/near", stamp, wire.encode_near(stamp, "map", np.ones((k % 3, 8))))
        writer.write("/uav1/setpoint/velocity", stamp, velocity.encode(stamp, np.full(6, k)))
        writer.write("/uav1/setpoint/wrench", stamp, wrench.encode(stamp, np.full(6, k)), stamp - 7)
        writer.write("/clock", stamp, wire.encode_clock(stamp))


def write_bag(path: Path, **options) -> Path:
    content = {"attachments": {"scenario.yaml": b"n: 1\n", "b": b"\0"}, "metadata": {"seed": "7"}}
    with BagWriter(path, TOPICS, **content, **options) as writer:
        write_all(writer)
    return path


def test_rosbags_reads_everything(tmp_path):
    highlevel = pytest.importorskip("rosbags.highlevel")
    path = write_bag(tmp_path / "flight")
    with highlevel.AnyReader([path]) as reader:
        assert reader.message_count == 5 * TICKS + 1
        assert {c.topic: c.msgtype for c in reader.connections} == {t.name: t.type for t in TOPICS}
        odoms = []
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic == "/uav1/odom":
                odoms.append((stamp, message))
            if connection.topic == "/uav1/setpoint/wrench":
                assert message.wrench.torque.z == (stamp - START_NS) // 10_000_000
    assert [stamp for stamp, _ in odoms] == [START_NS + k * 10_000_000 for k in range(TICKS)]
    assert odoms[3][1].header.frame_id == "map"
    assert odoms[3][1].pose.pose.orientation.w == 6.0 + 3
    assert odoms[3][1].twist.twist.angular.z == 12.0 + 3


def test_rosbag2_metadata(tmp_path):
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    with rosbag2.Reader(write_bag(tmp_path / "flight")) as reader:
        assert reader.start_time == START_NS
        assert reader.duration == (TICKS - 1) * 10_000_000 + 1
        for connection, topic in zip(reader.connections, TOPICS, strict=True):
            assert connection.topic == topic.name
            assert connection.digest == store.hash_rihs01(topic.type)
            (qos,) = connection.ext.offered_qos_profiles
            assert qos.reliability.name.lower() == topic.qos[0]["reliability"]
            assert qos.durability.name.lower() == topic.qos[0]["durability"]
            assert (qos.history.name.lower(), qos.depth) == ("keep_last", topic.qos[0]["depth"])


def test_mcap_records(tmp_path):
    """Summary, sequence numbers, publish times, and the same QoS in both places."""
    import yaml
    from mcap.reader import make_reader

    path = write_bag(tmp_path / "flight")
    outside = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    offered = {
        t["topic_metadata"]["name"]: t["topic_metadata"]["offered_qos_profiles"]
        for t in outside["topics_with_message_count"]
    }
    with (path / "flight_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        for channel in summary.channels.values():
            assert channel.message_encoding == "cdr"
            inside = yaml.safe_load(channel.metadata["offered_qos_profiles"])
            assert inside == offered[channel.topic]
        assert (outside["version"], outside["ros_distro"]) == (9, "jazzy")
        assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
        assert summary.statistics.message_count == outside["message_count"]
        wrenches = [m for _, _, m in reader.iter_messages(topics="/uav1/setpoint/wrench")]
        assert [m.sequence for m in wrenches] == list(range(TICKS))
        assert {m.log_time - m.publish_time for m in wrenches} == {7}
        records = {m.name: m.metadata for m in reader.iter_metadata()}
        assert records["ptnsbc"] == {"seed": "7"}
        assert yaml.safe_load(records["rosbag2"]["serialized_metadata"]) == outside
        assert {a.log_time for a in reader.iter_attachments()} == {0}


@pytest.mark.parametrize("compression", CompressionType)
def test_same_input_same_bytes(tmp_path, compression):
    first = write_bag(tmp_path / "a" / "flight", compression=compression)
    second = write_bag(tmp_path / "b" / "flight", compression=compression)
    names = sorted(p.name for p in first.iterdir())
    assert names == ["flight_0.mcap", "metadata.yaml"]
    for name in names:
        assert (first / name).read_bytes() == (second / name).read_bytes()


def test_existing_target(tmp_path):
    path = write_bag(tmp_path / "flight")
    with pytest.raises(BagError, match="flight exists: choose another name, or overwrite it"):
        write_bag(path)
    before = (path / "metadata.yaml").stat().st_ino
    write_bag(path, overwrite=True)
    assert (path / "metadata.yaml").stat().st_ino != before
    assert [p.name for p in tmp_path.iterdir()] == ["flight"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_no_other_folder_is_touched(tmp_path, overwrite):
    """A copy of an earlier flight that its user had called flight.old was removed with the new one in place."""
    kept = tmp_path / "flight.old" / "mine"
    kept.parent.mkdir()
    kept.touch()
    if overwrite:
        write_bag(tmp_path / "flight")
    write_bag(tmp_path / "flight", overwrite=overwrite)
    assert kept.exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["flight", "flight.old"]


def test_existing_part(tmp_path):
    (tmp_path / "flight.part").mkdir()
    with pytest.raises(BagError, match=r"flight\.part exists, a recording that was killed"):
        write_bag(tmp_path / "flight")
    write_bag(tmp_path / "flight", overwrite=True)


def test_target_that_appears_meanwhile(tmp_path):
    path = tmp_path / "flight"
    writer = BagWriter(path, TOPICS)
    writer.open()
    write_all(writer)
    path.mkdir()
    (path / "other").touch()
    with pytest.raises(BagError, match="the bag is complete in"):
        writer.close()
    assert read_bag(tmp_path / "flight.part").topics["/clock"].messages == TICKS


def test_exception_inside_still_gives_a_bag(tmp_path):
    with pytest.raises(ZeroDivisionError), BagWriter(tmp_path / "flight", TOPICS) as writer:
        write_all(writer)
        raise ZeroDivisionError
    assert read_bag(tmp_path / "flight").topics["/uav1/odom"].messages == TICKS


def test_unwritable_place(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(BagError, match="cannot be created"):
        BagWriter(tmp_path / "file" / "flight", TOPICS).open()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda w: w.write("/nope", 0, b""), "topic /nope: expected one of /uav1/odom"),
        (lambda w: w.write("/clock", -1, b""), "expected not negative"),
    ],
)
def test_wrong_write(tmp_path, call, message):
    with BagWriter(tmp_path / "x", TOPICS) as writer, pytest.raises(BagError, match=message):
        call(writer)


def test_full_disk(tmp_path):
    """A limit of the file size stands in for the disk."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    random = np.random.default_rng(1)
    odom = wire.OdometryTemplate("map", "uav1")
    message = r"flight\.part cannot be written \(File too large\): .* ptnsbc bag repair"
    writer = BagWriter(tmp_path / "flight", TOPICS, compression=CompressionType.NONE)
    writer.open()
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, before[1]))
        with pytest.raises(BagError, match=message):
            for k in range(10_000):
                writer.write("/uav1/odom", k, odom.encode(k, random.normal(size=13)))
        with pytest.raises(BagError, match=message):
            writer.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    stamps = [m.stamp_ns for m in read_bag(tmp_path / "flight.part", salvage=True).messages()]
    assert stamps == list(range(len(stamps)))
    assert len(stamps) > 1000


def test_write_into_a_closed_bag(tmp_path):
    writer = BagWriter(tmp_path / "x", TOPICS)
    with pytest.raises(BagError, match="expected an open bag"):
        writer.write("/clock", 0, b"")
    with writer:
        pass
    writer.close()  # a second time does nothing
    writer.flush_if_due(0.0)
    writer.flush_if_due(9.0)
    with pytest.raises(BagError, match="expected an open bag"):
        writer.write("/clock", 0, b"")


def test_flush_if_due(tmp_path):
    """What was flushed is on disk before the bag is closed, and a killed bag can be read."""
    writer = BagWriter(tmp_path / "flight", TOPICS)
    writer.open()
    file = tmp_path / "flight.part" / "flight_0.mcap"
    write_all(writer)
    for now in (10.0, 10.5):
        writer.flush_if_due(now)
    size = file.stat().st_size
    with pytest.raises(BagError, match=f"{5 * TICKS + 1} messages are readable"):
        read_bag(tmp_path / "flight.part")
    writer.flush_if_due(99.0)  # nothing new
    assert file.stat().st_size == size
    writer.close()
    assert len(list(read_bag(tmp_path / "flight").messages())) == 5 * TICKS + 1


def test_flush(tmp_path):
    with BagWriter(tmp_path / "flight", TOPICS) as writer:
        writer.flush()  # nothing yet
        writer.write("/clock", 7, wire.encode_clock(7))
        writer.flush()
        kept = read_bag(tmp_path / "flight.part", salvage=True)
        assert [message.stamp_ns for message in kept.messages()] == [7]
    writer.flush()  # closed


def test_a_recording_killed_soon_after_its_start_has_what_came_before_half_its_age(tmp_path):
    """After k steps of 10 ms at least k/2 are on the disk; chunks grow to half a second and no further."""
    writer = BagWriter(tmp_path / "flight", TOPICS)
    writer.open()
    file = tmp_path / "flight.part" / "flight_0.mcap"
    kept, flushes, size = [], [], file.stat().st_size
    for k in range(201):
        stamp_ns = 10_000_000 * k
        writer.write("/clock", stamp_ns, wire.encode_clock(stamp_ns))
        writer.flush_if_due(stamp_ns * 1e-9)
        if file.stat().st_size > size:
            size = file.stat().st_size
            flushes.append(k)
            kept = [m.stamp_ns for m in read_bag(file, salvage=True).messages()]
            assert kept == [10_000_000 * one for one in range(k + 1)]
        assert k < 1 or len(kept) > k / 2
    assert flushes == [1, 2, 4, 8, 16, 32, 64, 114, 164]
    writer.close()


ENDLESS = textwrap.dedent(
    """
    import signal, sys, time
    from pathlib import Path
    import numpy as np
    from ptnsbc_io import wire
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background starts without
    from ptnsbc_io.bag import BagWriter, declare
    odom = wire.OdometryTemplate("map", "uav1")
    with BagWriter(Path(sys.argv[1]), [declare("/o", "nav_msgs/msg/Odometry")]) as writer:
        for k in range(10**9):
            if k == int(sys.argv[2]):
                print("goes on", flush=True)
            writer.write("/o", k, odom.encode(k, np.full(13, k)))
            if k % 100 == 0:
                writer.flush_if_due(time.monotonic() * 20)
    """
)


def test_ctrl_c_waits_for_a_record_unless_rclpy_handles_it(tmp_path):
    """`simulate --bag` imports rclpy for its messages, and a record was cut by Ctrl-C."""
    rclpy = pytest.importorskip("rclpy.signals")
    options = rclpy.SignalHandlerOptions
    for number, of_rclpy in enumerate((options.NO, options.SIGINT)):
        rclpy.install_signal_handlers(of_rclpy)
        try:
            with BagWriter(tmp_path / str(number), TOPICS):
                default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
                assert default == (of_rclpy is not options.NO)
        finally:
            rclpy.uninstall_signal_handlers()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize(("how", "after"), [(signal.SIGINT, 5_000), (signal.SIGKILL, 11_000)])
def test_interrupted_process(tmp_path, how, after):
    process = subprocess.Popen(
        [sys.executable, "-c", ENDLESS, str(tmp_path / "flight"), str(after)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=Path(__file__).parents[3],
        env=os.environ,
    )
    assert process.stdout is not None
    try:
        process.stdout.readline()
        process.send_signal(how)
        process.wait(60)
    finally:
        process.kill()
        process.stdout.close()
    killed = how == signal.SIGKILL
    bag = read_bag(tmp_path / ("flight.part" if killed else "flight"), salvage=killed)
    stamps = [m.stamp_ns for m in bag.messages()]
    assert stamps == list(range(len(stamps)))
    assert len(stamps) > 100
