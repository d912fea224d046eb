"""A repair rescues what is readable of a killed, cut or damaged recording."""

from __future__ import annotations

from pathlib import Path

import pytest
from killed_recordings import killed_recordings

import ptnsbc
from ptnsbc_io import wire
from ptnsbc_io.bag import BagError, BagWriter, declare, read_bag
from ptnsbc_io.bag.reader import find_problems
from ptnsbc_tools.library.bags import repair
from ptnsbc_tools.replay.rerun import EQUAL

TOPICS = (
    declare("/uav1/odom", "nav_msgs/msg/Odometry", reliable=False, depth=1),
    declare("/formation/epoch", "std_msgs/msg/Header", latched=True, depth=1),
)
TICKS = 4000
EXTRAS = {"attachments": {"scenario.yaml": b"n: 1\n"}, "metadata": {"seed": "7"}}


def write(path: Path, pieces: int = 1) -> Path:
    odom = wire.OdometryTemplate("map", "uav1")
    with BagWriter(path, TOPICS, **EXTRAS) as writer:
        writer.write("/formation/epoch", 0, wire.HeaderTemplate("form").encode(0))
        for k in range(TICKS):
            if k and not k % (TICKS // pieces):
                writer.split()
            writer.write("/uav1/odom", k, odom.encode(k, [float(k)] * 13), sequence=k + 7)
    return path


@pytest.fixture
def flight(tmp_path) -> Path:
    return write(tmp_path / "flight")


@pytest.fixture(scope="module")
def split(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("split") / "flight", pieces=4)


def contents(path: Path) -> list:
    return sorted(read_bag(path).messages())


def whole(path: Path) -> bool:
    """Both by our own measure and by that of an independent reader, which must decode everything."""
    highlevel = pytest.importorskip("rosbags.highlevel")
    bag = read_bag(path)
    assert find_problems(bag) == []
    assert bag.metadata == {"seed": "7"}
    assert bag.attachment("scenario.yaml") == b"n: 1\n"
    with highlevel.AnyReader([path]) as reader:
        held = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()]
        assert len(held) == reader.message_count == len(list(bag.messages()))
        (epoch,) = (c for c in reader.connections if c.topic == "/formation/epoch")
        (qos,) = epoch.ext.offered_qos_profiles
        assert qos.durability.name == "TRANSIENT_LOCAL"
    return True


def test_killed_recording(flight):
    """DIR.part becomes DIR; what was there stays until it is told to go."""
    before = contents(flight)
    part = flight.rename(flight.with_name("flight.part"))
    (part / "metadata.yaml").unlink()
    file = part / "flight_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    made = repair(flight)
    assert (made.bag, made.original, made.cut) == (flight, part, True)
    assert whole(flight)
    assert contents(flight) == before[: made.messages]
    assert 0 < made.messages < len(before)
    assert made.last_ns == before[made.messages - 1].stamp_ns
    assert sorted(p.name for p in flight.iterdir()) == ["flight_0.mcap", "metadata.yaml"]


def test_every_length_of_the_last_chunk(tmp_path):
    """Wherever the kill fell, all whole chunks come back."""
    path = write(tmp_path / "flight")
    file = path / "flight_0.mcap"
    content = file.read_bytes()
    (path / "metadata.yaml").unlink()
    sizes = set()
    for size in range(len(content) - 1, len(content) // 2, -len(content) // 60):
        file.write_bytes(content[:size])
        made = repair(path, tmp_path / f"repaired{size}")
        assert [m.stamp_ns for m in read_bag(made.bag).messages(["/uav1/odom"])] == list(
            range(made.messages - 1)
        )
        sizes.add(made.messages)
    assert len(sizes) > 1


def test_damaged_chunk_in_place(flight):
    before = contents(flight)
    file = flight / "flight_0.mcap"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0xFF
    file.write_bytes(content)
    assert find_problems(read_bag(flight)) == ["flight_0.mcap: a damaged chunk"]
    made = repair(flight)
    assert (made.damaged_chunks, made.cut) == (1, False)
    assert made.original == flight.with_name("flight.original")
    assert whole(flight)
    left = contents(flight)
    assert set(left) < set(before)
    assert left[-1] == before[-1], "what came after the damage is there"
    assert (flight.with_name("flight.original") / "flight_0.mcap").read_bytes() == bytes(content)


def test_first_chunk_damaged(flight):
    """Names and types of the topics are in it, and in the summary."""
    file = flight / "flight_0.mcap"
    content = bytearray(file.read_bytes())
    content[content.find(b"zstd") + 100] ^= 0xFF
    file.write_bytes(content)
    (flight / "uav1.ulg").write_bytes(b"the log of an autopilot")
    made = repair(flight, discard=True)
    assert (flight / "uav1.ulg").read_bytes() == b"the log of an autopilot"
    assert made.original is None
    assert (made.damaged_chunks, made.cut) == (1, False)
    assert contents(flight)[-1].topic == "/uav1/odom"
    assert [p.name for p in flight.parent.iterdir()] == ["flight"]


def test_damaged_length_of_a_chunk(flight):
    file = flight / "flight_0.mcap"
    content = bytearray(file.read_bytes())
    second = content.find(b"zstd", content.find(b"zstd") + 4) - 41
    assert content[second] == 6
    content[second + 5] ^= 0xFF
    file.write_bytes(content)
    made = repair(flight)
    assert made.damaged_chunks == 1
    assert contents(flight)[-1].stamp_ns == TICKS - 1


def test_missing_metadata(flight):
    before = contents(flight)
    text = (flight / "metadata.yaml").read_text()
    (flight / "metadata.yaml").unlink()
    assert find_problems(read_bag(flight)) == ["metadata.yaml is missing"]
    repair(flight)
    assert (flight / "metadata.yaml").read_text() == text
    assert contents(flight) == before


def test_sequence_numbers_survive(flight):
    from mcap.reader import make_reader

    repair(flight)
    with (flight / "flight_0.mcap").open("rb") as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages(topics=["/uav1/odom"])
        assert [message.sequence for _, _, message in found] == list(range(7, TICKS + 7))


def test_split_bag(split, tmp_path):
    before = contents(split)
    made = repair(split, tmp_path / "again")
    assert [p.name for p in sorted(made.bag.iterdir())] == [
        *(f"again_{k}.mcap" for k in range(4)),
        "metadata.yaml",
    ]
    assert whole(made.bag)
    assert contents(made.bag) == before


def test_split_bag_reads_as_one(split):
    files = sorted(p.name for p in split.glob("*.mcap"))
    assert files == [f"flight_{k}.mcap" for k in range(4)]
    assert whole(split)
    bag = read_bag(split)
    assert bag.topics["/uav1/odom"].messages == TICKS
    assert [m.stamp_ns for m in bag.messages(["/uav1/odom"])] == list(range(TICKS))
    assert (bag.start_ns, bag.end_ns) == (0, TICKS - 1)
    one = read_bag(split / "flight_2.mcap")
    assert one.topics["/uav1/odom"].messages == TICKS // 4


def test_more_than_ten_pieces_stay_in_order(tmp_path):
    path = write(tmp_path / "flight", pieces=12)
    assert (path / "flight_11.mcap").exists()
    stamps = [m.stamp_ns for m in read_bag(path).messages(["/uav1/odom"])]
    assert stamps == list(range(TICKS))


def test_single_file(flight, tmp_path):
    made = repair(flight / "flight_0.mcap")
    assert made.bag == flight / "flight_0.repaired"
    assert whole(made.bag)


@pytest.mark.parametrize(
    ("prepare", "message"),
    [
        (lambda p: None, "no such bag"),
        (lambda p: p.write_bytes(b""), "is empty"),
        (lambda p: p.write_bytes(b"SQLite format 3\0" + bytes(100)), "is not MCAP"),
        (lambda p: p.write_bytes(b"\x89MCAP0\r\n"), "holds no message"),
        (lambda p: p.mkdir(), r"no \.mcap file"),
    ],
)
def test_hopeless(tmp_path, prepare, message):
    path = tmp_path / "x"
    prepare(path)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(BagError, match=message):
        repair(path)
    assert sorted(tmp_path.iterdir()) == before


def test_nothing_is_overwritten(flight):
    flight.with_name("flight.original").mkdir()
    with pytest.raises(BagError, match="original exists: move it away"):
        repair(flight)
    with pytest.raises(BagError, match="exists: move it away"):
        repair(flight, flight.with_name("flight.original"))


@pytest.mark.slow
def test_kill_at_any_moment(tmp_path):
    """Six processes that write as the recorder does; `python -m bench.signals` kills real recorders."""
    pytest.importorskip("rosbags")
    killed = list(killed_recordings(6, 3, tmp_path))
    assert len(killed) == 6
    assert all(kill.missing == 0 and kill.messages > 100 for kill in killed)
    assert max(kill.loss_s for kill in killed) < 1.0


SAMPLE = Path(__file__).parents[3] / "bags" / "sample"


@pytest.mark.slow
def test_the_sample_bag_runs_again_byte_for_byte() -> None:
    found = ptnsbc.rerun(SAMPLE, progress=False)
    assert (found.verdict, found.first) == (EQUAL, None)
