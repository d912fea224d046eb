"""Bags of other systems: sqlite3, MCAP, compressed, their own topics; the verdict is the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ptnsbc_io.bag import BagError, BagWriter, TopicInfo
from ptnsbc_io.wire import OdometryTemplate
from ptnsbc_sim.scenario import ScenarioError
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_tools.reading.bag_reader import ReadOptions, read_recording
from ptnsbc_tools.reading.bag_sources import TopicNames, TopicPatternError

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

STORE = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
PLUGIN = {"sqlite3": rosbag2.StoragePlugin.SQLITE3, "mcap": rosbag2.StoragePlugin.MCAP}
LATE_S = 1.5  # the epoch, after the first message
WALL_NS = 1_700_000_000_000_000_000
DRONES = TopicNames(odom="/drone{n}/odom", wrench="/drone{n}/nothing", estimate="/drone{n}/nothing")


@pytest.fixture
def flown(fly):
    """UAV 3 is 20 cm beside its place until 4 s after the epoch."""
    return fly({3: lambda t: np.where(t < 4.0, 0.2, 0.0)})


@pytest.fixture
def scenario(flown, tmp_path) -> Path:
    path = tmp_path / "scenario.yaml"
    path.write_text(flown.scenario.text)
    return path


def messages(flown, *, stamped: bool = True):
    for uav, series in flown.odometry.items():
        template = OdometryTemplate("map", f"drone{uav}")
        for t_ns, values in zip(series.t_ns, series.values, strict=True):
            log_ns = WALL_NS + int(t_ns)
            yield uav, log_ns, template.encode(log_ns if stamped else 0, values)


def record(path: Path, flown, plugin: str, *, stamped: bool = True, compress: str = "") -> Path:
    """As others would: by rosbags, only odometry, by the wall clock."""
    writer = rosbag2.Writer(path, version=9, storage_plugin=PLUGIN[plugin])
    if compress:
        writer.set_compression(rosbag2.CompressionMode[compress], rosbag2.CompressionFormat.ZSTD)
    kind = "nav_msgs/msg/Odometry"
    with writer:
        topics = {
            uav: writer.add_connection(f"/drone{uav}/odom", kind, typestore=STORE)
            for uav in flown.scenario.uav_ids
        }
        for uav, log_ns, data in messages(flown, stamped=stamped):
            writer.write(topics[uav], log_ns, data)
    return path


@pytest.mark.parametrize("plugin", ["sqlite3", "mcap"])
@pytest.mark.parametrize("stamped", [True, False])
def test_the_same_verdict(flown, scenario, tmp_path, plugin, stamped):
    bag = record(tmp_path / "bag", flown, plugin, stamped=stamped)
    found = verdict_on(read_recording(bag, ReadOptions(scenario, names=DRONES)))
    expected = verdict_on(flown)
    assert found.verdict == expected.verdict == "met"
    for one, other in zip(found.uavs, expected.uavs, strict=True):
        assert one.settling_s == pytest.approx(other.settling_s)
        assert one.error_at_deadline_m == pytest.approx(other.error_at_deadline_m, abs=1e-12)
    assert found.uavs[2].settling_s == pytest.approx(4.0)
    assert found.efforts == ()


@pytest.mark.parametrize(("plugin", "mode"), [("sqlite3", "MESSAGE"), ("sqlite3", "FILE")])
def test_compressed_by_rosbag2(flown, scenario, tmp_path, plugin, mode):
    bag = record(tmp_path / "bag", flown, plugin, compress=mode)
    assert verdict_on(read_recording(bag, ReadOptions(scenario, names=DRONES))).verdict == "met"


def test_epoch_of_a_bag_without_one(flown, scenario, tmp_path):
    bag = record(tmp_path / "bag", flown, "sqlite3")
    found = verdict_on(read_recording(bag, ReadOptions(scenario, epoch_s=LATE_S, names=DRONES)))
    assert found.epoch_s == pytest.approx(WALL_NS * 1e-9 + LATE_S)
    assert found.uavs[2].settling_s == pytest.approx(4.0 - LATE_S)


def test_sqlite_file_stands_for_its_folder(flown, scenario, tmp_path):
    bag = record(tmp_path / "bag", flown, "sqlite3")
    (file,) = bag.glob("*.db3")
    assert verdict_on(read_recording(file, ReadOptions(scenario, names=DRONES))).verdict == "met"


@pytest.mark.parametrize("pattern", ["/odom", "/drone{N}/odom", ""])
def test_pattern_without_a_uav(pattern):
    with pytest.raises(TopicPatternError, match=r"expected \{n\} for the id of the UAV"):
        TopicNames(odom=pattern)


def test_what_is_missing_is_said(flown, scenario, tmp_path):
    bag = record(tmp_path / "bag", flown, "sqlite3")
    with pytest.raises(BagError, match=r"no scenario\.yaml attached: name the scenario with"):
        read_recording(bag, ReadOptions(None, names=DRONES))
    nothing = read_recording(bag, ReadOptions(scenario))
    with pytest.raises(Exception, match="expected odometry of every UAV"):
        verdict_on(nothing)


def test_other_types_are_refused(flown, scenario, tmp_path):
    with BagWriter(tmp_path / "x", [TopicInfo("/uav1/odom", "std_msgs/msg/Header")]) as writer:
        writer.write("/uav1/odom", 0, b"\0\1\0\0" + bytes(16))
    with pytest.raises(BagError, match=r"/uav1/odom is std_msgs/msg/Header: expected nav_msgs"):
        read_recording(tmp_path / "x", ReadOptions(scenario))


@pytest.mark.parametrize("damage", ["cut", "empty", "metadata"])
def test_damaged_sqlite(flown, scenario, tmp_path, damage):
    bag = record(tmp_path / "bag", flown, "sqlite3")
    (file,) = bag.glob("*.db3")
    content = file.read_bytes()
    if damage == "metadata":
        (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    else:
        file.write_bytes(content[: len(content) // 2] if damage == "cut" else b"")
    with pytest.raises(BagError, match=r"cannot be read \(|is damaged"):
        verdict_on(read_recording(bag, ReadOptions(scenario, names=DRONES)))


def test_the_scenario_of_a_bag_reads_no_file(tmp_path: Path) -> None:
    """`extends: /etc/shadow` made `ptnsbc verify` print its first line."""
    secret = tmp_path / "secret.yaml"
    secret.write_text("password")
    infos = [TopicInfo("/uav1/odom", "nav_msgs/msg/Odometry")]
    attached = {"scenario.yaml": f"name: x\nextends: {secret}\n".encode()}
    with BagWriter(tmp_path / "flight", infos, attachments=attached) as writer:
        writer.write("/uav1/odom", 0, OdometryTemplate("map", "x").encode(0, np.ones(13)))
    with pytest.raises(ScenarioError, match="expected a whole scenario") as refused:
        read_recording(tmp_path / "flight")
    assert "password" not in str(refused.value)
