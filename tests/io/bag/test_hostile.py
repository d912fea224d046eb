"""Bags that were made to do harm: linear time, bounded memory, a BagError for each, nothing outside the bag."""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.opcode import Opcode

from ptnsbc_io.bag import BagError, BagWriter, declare, mcap_file, read_bag
from ptnsbc_io.bag.mcap_file import LARGEST_CHUNK, MAGIC, MOST_MESSAGES
from ptnsbc_io.bag.reader import find_problems
from ptnsbc_io.wire import HeaderTemplate
from ptnsbc_tools.library.bags import repair

TOPIC = declare("/formation/epoch", "std_msgs/msg/Header")
EPOCH = HeaderTemplate("form").encode(0)
COMPRESS = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}


def write(path: Path, messages: int = 3, **options) -> Path:
    with BagWriter(path, [TOPIC], **options) as writer:
        for k in range(messages):
            writer.write(TOPIC.name, k, EPOCH)
    return path


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def message(log_ns: int = 0, data: bytes = b"") -> bytes:
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 0, log_ns, log_ns) + data)


def chunk(unpacked: bytes, compression: str, size: int | None = None) -> bytes:
    packed = COMPRESS[compression](unpacked)
    length = len(unpacked) if size is None else size
    start = struct.pack("<QQQI", 0, 0, length, zlib.crc32(unpacked)) + text(compression)
    return record(Opcode.CHUNK, start + struct.pack("<Q", len(packed)) + packed)


def channel(**metadata: str) -> bytes:
    pairs = b"".join(text(key) + text(value) for key, value in metadata.items())
    names = text(TOPIC.name) + text("cdr")
    return record(
        Opcode.CHANNEL, struct.pack("<HH", 1, 1) + names + struct.pack("<I", len(pairs)) + pairs
    )


SCHEMA = record(Opcode.SCHEMA, struct.pack("<H", 1) + text(TOPIC.type) + text("ros2msg") + text(""))


def file(path: Path, *parts: bytes) -> Path:
    """An MCAP file without an end, which starts with one good message."""
    path.write_bytes(b"".join((MAGIC, SCHEMA, channel(), message(0, EPOCH), *parts)))
    return path


def readable(path: Path) -> int:
    return sum(1 for _ in read_bag(path, salvage=True).messages())


@pytest.fixture
def work(monkeypatch):
    """Bytes of the records that were read from files."""
    done = [0]
    add = mcap_file.Contents.add

    def counted(self, place, body, *more):
        done[0] += len(body)
        return add(self, place, body, *more)

    monkeypatch.setattr(mcap_file.Contents, "add", counted)
    return done


@pytest.mark.parametrize("filler", [b"\0", b"\x10" + bytes(8), b"\x80" + bytes(8), b"\xff"])
def test_rubbish_at_the_end_takes_linear_time(tmp_path, work, filler):
    """A megabyte of zeros took more than 100 s: every damaged record was searched to the end of the file."""
    path = file(tmp_path / "filled.mcap", filler * (100_000 // len(filler)))
    assert readable(path) == 1
    assert work[0] <= 10 * path.stat().st_size


def test_damaged_chunks_inside_each_other_take_linear_time(tmp_path, work):
    """Each of them reaches to the end of the file."""
    piece = struct.pack("<QQQI", 0, 0, 100, 1) + text("zstd") + struct.pack("<Q", 0)
    count, size = 3000, 9 + len(piece)
    heads = [struct.pack("<BQ", Opcode.CHUNK, (count - k) * size - 9) for k in range(count)]
    path = file(tmp_path / "nested.mcap", *[head + piece for head in heads])
    assert readable(path) == 1
    assert work[0] <= 20 * path.stat().st_size


@pytest.mark.parametrize("compression", COMPRESS)
@pytest.mark.parametrize("honest", [True, False])
def test_a_chunk_that_unpacks_to_too_much_is_damaged(tmp_path, compression, honest):
    """A file of 22 MB took 2.8 GB."""
    bomb = chunk(bytes(LARGEST_CHUNK + 1), compression, None if honest else 100)
    path = file(tmp_path / "bomb.mcap", bomb)
    with pytest.raises(BagError, match=r"damaged|cut"):
        list(read_bag(path).messages())
    assert readable(path) == 1


def test_many_chunks_unpack_to_a_bound(tmp_path):
    """Each is small enough; together 89 kB took 3 GB and 100 s."""
    filled = chunk(message(data=bytes(LARGEST_CHUNK // 4)), "zstd")
    path = file(tmp_path / "bombs.mcap", *[filled] * 30)
    bound = mcap_file.LEAST_UNPACKED + mcap_file.UNPACKED_RATIO * path.stat().st_size
    unpacked = sum(len(one.data) for one in read_bag(path, salvage=True).messages())
    assert unpacked <= bound < 30 * LARGEST_CHUNK // 4


def test_a_chunk_of_too_many_messages_is_damaged(tmp_path):
    path = file(tmp_path / "crowd.mcap", chunk(message() * (MOST_MESSAGES + 1), "zstd"))
    assert readable(path) == 1


def test_many_chunks_hold_a_bound_of_messages(tmp_path):
    """26 kB took half a minute."""
    filled = chunk(message() * (MOST_MESSAGES // 4), "zstd")
    path = file(tmp_path / "crowds.mcap", *[filled] * 20)
    bound = MOST_MESSAGES + path.stat().st_size // mcap_file.LEAST_PACKED
    assert readable(path) <= bound


def test_a_chunk_of_zeros_is_damaged(tmp_path):
    path = file(tmp_path / "zeros.mcap", chunk(bytes(1 << 20), "lz4"))
    assert readable(path) == 1


@pytest.mark.parametrize("packed", [True, False])
def test_times_that_no_clock_shows_cost_no_message(tmp_path, packed):
    """Nine of them cost 1387 messages: all of their chunks."""
    wrong = record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 0, 2**63, 6) + EPOCH)
    records = message(5, EPOCH) + wrong + message(2**64 - 1, EPOCH) + message(7, EPOCH)
    path = file(tmp_path / "late.mcap", chunk(records, "zstd") if packed else records)
    with pytest.raises(BagError, match=r"is damaged|is cut"):
        read_bag(path)
    made = repair(path)
    assert (made.messages, made.wrong_times, made.damaged_chunks) == (5, 2, 0)
    # The time of publication, or the time of the message before.
    assert [one.stamp_ns for one in read_bag(made.bag).messages()] == [0, 5, 6, 6, 7]
    assert find_problems(read_bag(made.bag)) == []


def test_times_of_a_bag_that_ends_well_are_damage_too(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "late.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema(TOPIC.type, "ros2msg", b"")
        topic = writer.register_channel(TOPIC.name, "cdr", schema)
        for log_ns in (1, 2**64 - 1, 3):
            writer.add_message(topic, log_ns, EPOCH, 2)
        writer.finish()
    with pytest.raises(BagError, match="is damaged"):
        read_bag(path)
    assert find_problems(read_bag(path, salvage=True)) == [
        "late.mcap: a time that no clock shows",
        "metadata.yaml is missing",
    ]
    assert [one.stamp_ns for one in read_bag(repair(path).bag).messages()] == [1, 2, 3]


def test_a_pipe_is_no_bag(tmp_path):
    """Opening it would wait for ever."""
    os.mkfifo(tmp_path / "flight_0.mcap")
    for path in (tmp_path, tmp_path / "flight_0.mcap"):
        with pytest.raises(BagError, match="expected a file"):
            read_bag(path)
        with pytest.raises(BagError, match="expected a file"):
            repair(path, tmp_path / "repaired")


@pytest.mark.parametrize(
    "stated",
    [
        "[" * 10_000,
        f"rosbag2_bagfile_information: {{relative_file_paths: [a], message_count: {'9' * 5000}}}",
        "rosbag2_bagfile_information: {relative_file_paths: 7, message_count: 3}",
        "a: &a [x]\nrosbag2_bagfile_information: {relative_file_paths: [*a, *a], message_count: 3}",
        "x" * 6_000_000,
    ],
    ids=["nested", "digits", "number", "aliases", "large"],
)
def test_a_broken_metadata_file_is_a_problem_of_the_bag(tmp_path, stated):
    bag = write(tmp_path / "flight")
    (bag / "metadata.yaml").write_text(stated)
    assert find_problems(read_bag(bag)) == ["metadata.yaml cannot be read"]


@pytest.mark.parametrize(
    "qos",
    ["[" * 5000, f"- {{depth: {'9' * 5000}}}", "[2026-01-01]", "- &a [x, *a]", "- {a: [b]}", "7"],
)
def test_repair_leaves_out_a_quality_of_service_that_is_none(tmp_path, qos):
    path = tmp_path / "qos.mcap"
    path.write_bytes(MAGIC + SCHEMA + channel(offered_qos_profiles=qos) + message(data=EPOCH))
    made = repair(path)
    assert find_problems(read_bag(made.bag)) == []


def test_overwrite_replaces_bags_only(tmp_path):
    """`--bag ~ --overwrite` deleted the folder, whatever was in it."""
    folder = tmp_path / "thesis"
    (folder / "chapters").mkdir(parents=True)
    (folder / "chapters" / "one.tex").write_text("years of work")
    (tmp_path / "letter").write_text("dear")
    for path, foreign in ((folder, "chapters"), (tmp_path / "letter", "letter")):
        with pytest.raises(BagError, match=f"{foreign}.*bag"):
            write(path, overwrite=True)
    bag = write(tmp_path / "flight")
    (bag / "notes.txt").write_text("mine")
    with pytest.raises(BagError, match=r"notes\.txt"):
        write(bag, overwrite=True)
    (bag / "notes.txt").unlink()
    part = tmp_path / "flight.part"
    part.mkdir()
    (part / "mine.txt").write_text("mine")
    with pytest.raises(BagError, match=r"mine\.txt"):
        write(bag, overwrite=True)
    assert (folder / "chapters" / "one.tex").read_text() == "years of work"
    assert readable(bag) == 3
    (part / "mine.txt").unlink()
    assert readable(write(bag, 5, overwrite=True)) == 5
