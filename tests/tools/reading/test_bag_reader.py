"""Bags that others wrote, and what the verdict and figures read of them."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from typer.testing import CliRunner

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import BagError, BagWriter, declare, read_bag
from ptnsbc_io.bag.reader import find_problems
from ptnsbc_io.wire import (
    Diagnostics,
    DiagnosticStatus,
    HeaderTemplate,
    OdometryTemplate,
    encode_near,
)
from ptnsbc_nodes.comm import topics
from ptnsbc_sim.scenario import ScenarioError
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_tools.cli import app
from ptnsbc_tools.library.bags import repair
from ptnsbc_tools.options import ReadOptions, TopicPatternError
from ptnsbc_tools.reading.bag_reader import (
    DiagnosticCounters,
    read_recording,
)
from ptnsbc_tools.reading.disk_track import SampleFile
from ptnsbc_tools.replay.rerun import rerun


@pytest.fixture(scope="module")
def brief(headless, tmp_path_factory) -> bytes:
    """Eight ticks of a flight, uncompressed: a flipped byte is one of a message, an index, a name."""
    flown = read_bag(headless)
    path = tmp_path_factory.mktemp("brief") / "x"
    infos = [declare(topic.name, topic.type) for topic in flown.topics.values()]
    attachments = {"scenario.yaml": flown.attachment("scenario.yaml")}
    with BagWriter(
        path, infos, attachments=attachments, compression=CompressionType.NONE
    ) as writer:
        for message in flown.messages():
            if message.stamp_ns < 80_000_000:
                writer.write(*message)
    return (path / "x_0.mcap").read_bytes()


def used(path: Path, scenario) -> None:
    """Everything that reads bags; each may refuse, none may fall over."""
    for use in (
        lambda: verdict_on(read_recording(path)),
        lambda: rerun(read_bag(path), scenario),
        lambda: find_problems(read_bag(path, salvage=True)),
        lambda: repair(path, path.parent / "repaired"),
    ):
        try:
            use()
        except PtnsbcError as error:
            assert str(error)


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_damage_in_the_file(brief, scenario, tmp_path_factory, data):
    content = bytearray(brief)
    for at in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=4)):
        content[at] ^= data.draw(st.integers(1, 255))
    size = data.draw(st.one_of(st.just(len(content)), st.integers(0, len(content))))
    folder = tmp_path_factory.mktemp("fuzz")
    path = folder / "x.mcap"
    path.write_bytes(content[:size])
    used(path, scenario)
    shutil.rmtree(folder)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["headless", "realtime"])
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_damage_in_messages_that_checksums_hide(kind, request, scenario, tmp_path_factory, data):
    """As if the sender had been at fault: the file is whole, the messages are not."""
    folder = tmp_path_factory.mktemp("fuzz")
    flown = read_bag(request.getfixturevalue(kind))
    end_ns = flown.start_ns + 150_000_000
    start_ns = data.draw(st.sampled_from([0, flown.start_ns, flown.start_ns + 20_000_000]))
    infos = [declare(topic.name, topic.type) for topic in flown.topics.values()]
    chosen = data.draw(st.sampled_from(sorted(flown.topics)))
    at = data.draw(st.integers(0, 200))
    value = data.draw(st.integers(0, 255))
    cut = data.draw(st.one_of(st.none(), st.integers(0, 300)))
    attachments = {"scenario.yaml": flown.attachment("scenario.yaml")}
    with BagWriter(folder / "x", infos, attachments=attachments) as writer:
        for message in flown.messages():
            if message.stamp_ns < end_ns:
                content = bytearray(message.data)
                if message.topic == chosen and message.stamp_ns >= start_ns:
                    content[min(at, len(content) - 1)] = value
                    content = content[:cut]
                writer.write(message.topic, message.stamp_ns, bytes(content))
    used(folder / "x", scenario)
    shutil.rmtree(folder)


BAD = {
    "missing": lambda path: None,
    "empty": lambda path: path.write_bytes(b""),
    "empty folder": lambda path: path.mkdir(),
    "foreign": lambda path: path.write_bytes(b"SQLite format 3\0" + bytes(100)),
    "magic alone": lambda path: path.write_bytes(b"\x89MCAP0\r\n"),
    "noise": lambda path: path.write_bytes(np.random.default_rng(1).bytes(5000)),
}
COMMANDS = (
    ("verify",),
    ("bag", "replay", "--rerun"),
    ("bag", "replay", "--publish"),
    ("bag", "info"),
    ("bag", "repair"),
    ("plot",),
)


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_commands_refuse_in_one_line(brief, tmp_path, command, capfd):
    from typer.main import get_command

    from ptnsbc_tools.cli import app

    bad = {**BAD, "cut": lambda path: path.write_bytes(brief[: len(brief) // 40])}
    for number, (what, prepare) in enumerate(bad.items()):
        path = tmp_path / f"bad{number}"
        prepare(path)
        before = sorted(tmp_path.iterdir())
        with pytest.raises(SystemExit) as left:
            get_command(app)([*command, str(path)], prog_name="ptnsbc")
        out, err = capfd.readouterr()
        assert left.value.code == 2, f"{what}: {out}{err}"
        assert out == "", what
        assert len(err.splitlines()) == 1, f"{what}: {err}"
        assert sorted(tmp_path.iterdir()) == before, f"{what}: something was left behind"


@pytest.mark.slow
def test_memory_does_not_grow_with_the_bag(tmp_path, scenario):
    """Twice the flight, the same peak: messages stream, and a re-run keeps a window of them."""
    peaks = []
    for ticks in (750, 1500):
        bag = read_bag(write_long(tmp_path / f"bag{ticks}", scenario, ticks))
        tracemalloc.start()
        assert sum(1 for _ in bag.messages()) > 10 * ticks
        rerun(bag, scenario)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.25 * peaks[0]


def write_long(path: Path, scenario, ticks: int) -> Path:
    """UAVs that stand still: big, and quick to make."""
    recorded = [topic for uav in scenario.uav_ids for topic in topics.of_uav(uav)[:4]]
    infos = [declare(topic.name, topic.type) for topic in (*recorded, topics.EPOCH)]
    state = OdometryTemplate("map", "uav")
    still = np.eye(13)[6]
    with BagWriter(path, infos) as writer:
        writer.write(topics.EPOCH.name, 0, HeaderTemplate("form").encode(0))
        for k in range(ticks):
            stamp = k * scenario.timing.dt_ns
            near = encode_near(stamp, "map", np.zeros((0, 8)))
            for topic in recorded:
                data = near if topic.name.endswith("/near") else state.encode(stamp, still)
                writer.write(topic.name, stamp, data)
    return path


def test_a_killed_reader_of_a_pipe_is_no_traceback(headless):
    """`ptnsbc bag info X | head -1`."""
    command = f"{sys.executable} -m ptnsbc_tools.cli bag info {headless} | head -1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr


def array_of(name: str, value: str) -> Diagnostics:
    return Diagnostics(0, (DiagnosticStatus(name, 0, "", {"states_sent": value}),))


def test_counts_are_read_from_the_diagnostics_of_bridges() -> None:
    stamp = 1_795_289_342_123_456_789  # does not fit a float
    statuses = [
        array_of("bridge2: link", f"{stamp} 7"),
        array_of("bridge2: link", f"{stamp} 7"),  # nothing new since
        array_of("bridge2: link", f"{stamp + 20_000_000} 8"),
        array_of("bridge3: link", "0 0"),  # nothing sent yet
        array_of("bridge4: link", "rubbish"),
        array_of("uav1: planner", f"{stamp} 9"),
    ]
    counted = DiagnosticCounters(SampleFile())
    for array in statuses:
        counted.add(array)
    found = counted.sent.tracks()
    assert list(found) == [2]
    (block,) = found[2].blocks()
    assert block.t_ns.tolist() == [stamp, stamp + 20_000_000]
    assert block.values.tolist() == [[7.0], [8.0]]


@pytest.mark.parametrize(
    "sent",
    ["9" * 5000 + " 1", "1 " + "9" * 5000, f"{2**63} 1", f"0 {2**80}", "١ 1", "inf inf", " "],
)
def test_numbers_that_no_bridge_sends_count_as_none(sent: str) -> None:
    counted = DiagnosticCounters(SampleFile())
    counted.add(array_of("bridge2: link", sent))
    counted.add(array_of(f"bridge{'2' * 5000}: link", "1 1"))
    assert counted.sent.tracks() == {}


def test_a_counter_that_is_no_number_counts_as_zero() -> None:
    counted = DiagnosticCounters(SampleFile())
    values = {"missed_ticks": "inf", "ticks": "nan", "holding_s": "1e999", "saturated_s": "2.5"}
    counted.add(Diagnostics(0, (DiagnosticStatus("uav1: planner", 0, "", values),)))
    counted.add(Diagnostics(0, (DiagnosticStatus(f"uav{'1' * 5000}: planner", 0, "", values),)))
    (block,) = counted.counters.tracks()[1].blocks()
    assert block.values.sum() == 2.5


rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

STORE = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
PLUGIN = {"sqlite3": rosbag2.StoragePlugin.SQLITE3, "mcap": rosbag2.StoragePlugin.MCAP}
LATE_S = 1.5  # the epoch, after the first message
WALL_NS = 1_700_000_000_000_000_000
DRONES = {"odom": "/drone{n}/odom", "wrench": "/drone{n}/nothing"}


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
def test_the_same_verdict(flown, scenario_file, tmp_path, plugin, stamped):
    bag = record(tmp_path / "bag", flown, plugin, stamped=stamped)
    found = verdict_on(read_recording(bag, ReadOptions(scenario_file, **DRONES)))
    expected = verdict_on(flown)
    assert found.verdict == expected.verdict == "met"
    for one, other in zip(found.uavs, expected.uavs, strict=True):
        assert one.settling_s == pytest.approx(other.settling_s)
        assert one.error_at_deadline_m == pytest.approx(other.error_at_deadline_m, abs=1e-12)
    assert found.uavs[2].settling_s == pytest.approx(4.0)
    assert found.efforts == ()


@pytest.mark.parametrize(("plugin", "mode"), [("sqlite3", "MESSAGE"), ("sqlite3", "FILE")])
def test_compressed_by_rosbag2(flown, scenario_file, tmp_path, plugin, mode):
    bag = record(tmp_path / "bag", flown, plugin, compress=mode)
    assert verdict_on(read_recording(bag, ReadOptions(scenario_file, **DRONES))).verdict == "met"


def test_epoch_of_a_bag_without_one(flown, scenario_file, tmp_path):
    bag = record(tmp_path / "bag", flown, "sqlite3")
    found = verdict_on(read_recording(bag, ReadOptions(scenario_file, epoch_s=LATE_S, **DRONES)))
    assert found.epoch_s == pytest.approx(WALL_NS * 1e-9 + LATE_S)
    assert found.uavs[2].settling_s == pytest.approx(4.0 - LATE_S)


def test_sqlite_file_stands_for_its_folder(flown, scenario_file, tmp_path):
    bag = record(tmp_path / "bag", flown, "sqlite3")
    (file,) = bag.glob("*.db3")
    assert verdict_on(read_recording(file, ReadOptions(scenario_file, **DRONES))).verdict == "met"


def test_every_command_reads_a_bag_that_rosbag2_converted(headless, scenario, tmp_path):
    from ptnsbc_nodes.recording.player import profile

    with (
        rosbag2.Reader(headless) as reader,
        rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=PLUGIN["sqlite3"]) as writer,
    ):
        made = {
            c.topic: writer.add_connection(
                c.topic,
                c.msgtype,
                typestore=STORE,
                offered_qos_profiles=c.ext.offered_qos_profiles,
            )
            for c in reader.connections
        }
        for connection, stamp_ns, data in reader.messages():
            writer.write(made[connection.topic], stamp_ns, data)
    flown, bag = read_bag(headless), read_bag(tmp_path / "bag")
    kept = {name: topic for name, topic in flown.topics.items() if topic.messages}
    assert {name: topic.messages for name, topic in bag.topics.items()} == {
        name: topic.messages for name, topic in kept.items()
    }
    assert all(profile(bag.topics[name]) == profile(topic) for name, topic in kept.items())
    assert rerun(bag, scenario).verdict == "equal"
    shown = CliRunner().invoke(app, ["bag", "info", str(tmp_path / "bag")])
    assert shown.exit_code == 0 and set(kept) <= set(shown.stdout.split())
    refused = CliRunner().invoke(app, ["bag", "info", str(tmp_path / "bag"), "--check"])
    assert refused.exit_code == 2 and "only they have checksums" in refused.stderr
    with pytest.raises(BagError, match="`ros2 bag convert` makes of others"):
        repair(tmp_path / "bag", tmp_path / "part")


@pytest.mark.parametrize("pattern", ["/odom", "/drone{N}/odom", ""])
def test_pattern_without_a_uav(pattern):
    with pytest.raises(TopicPatternError, match=r"expected \{n\} for the id of the UAV"):
        ReadOptions(odom=pattern)


def test_what_is_missing_is_said(flown, scenario_file, tmp_path):
    bag = record(tmp_path / "bag", flown, "sqlite3")
    with pytest.raises(BagError, match=r"no scenario\.yaml attached: give the scenario file"):
        read_recording(bag, ReadOptions(None, **DRONES))
    nothing = read_recording(bag, ReadOptions(scenario_file, odom="/px4_{n}/odom"))
    with pytest.raises(
        Exception, match=r"no message on /px4_1/odom.*expected odometry of every UAV"
    ):
        verdict_on(nothing)


def test_other_types_are_refused(flown, scenario_file, tmp_path):
    with BagWriter(tmp_path / "x", [declare("/uav1/odom", "std_msgs/msg/Header")]) as writer:
        writer.write("/uav1/odom", 0, b"\0\1\0\0" + bytes(16))
    with pytest.raises(BagError, match=r"/uav1/odom is std_msgs/msg/Header: expected nav_msgs"):
        read_recording(tmp_path / "x", ReadOptions(scenario_file))


@pytest.mark.parametrize("damage", ["cut", "empty", "metadata"])
def test_damaged_sqlite(flown, scenario_file, tmp_path, damage):
    bag = record(tmp_path / "bag", flown, "sqlite3")
    (file,) = bag.glob("*.db3")
    content = file.read_bytes()
    if damage == "metadata":
        (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    else:
        file.write_bytes(content[: len(content) // 2] if damage == "cut" else b"")
    with pytest.raises(BagError, match=r"cannot be read \(|is damaged"):
        verdict_on(read_recording(bag, ReadOptions(scenario_file, **DRONES)))


def test_the_scenario_of_a_bag_reads_no_file(tmp_path: Path) -> None:
    """`extends: /etc/shadow` made `ptnsbc verify` print its first line."""
    secret = tmp_path / "secret.yaml"
    secret.write_text("password")
    infos = [declare("/uav1/odom", "nav_msgs/msg/Odometry")]
    attached = {"scenario.yaml": f"name: x\nextends: {secret}\n".encode()}
    with BagWriter(tmp_path / "flight", infos, attachments=attached) as writer:
        writer.write("/uav1/odom", 0, OdometryTemplate("map", "x").encode(0, np.ones(13)))
    with pytest.raises(ScenarioError, match="expected a whole scenario") as refused:
        read_recording(tmp_path / "flight")
    assert "password" not in str(refused.value)
