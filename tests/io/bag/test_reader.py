"""Reading back, and the words for every kind of broken bag."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType

from ptnsbc_io import wire
from ptnsbc_io.bag import BagError, BagWriter, declare, read_bag
from ptnsbc_io.bag.reader import find_problems

TOPICS = (
    declare("/uav1/odom", "nav_msgs/msg/Odometry", reliable=False),
    declare("/clock", "rosgraph_msgs/msg/Clock"),
    declare("/unused", "std_msgs/msg/Header"),
)
TICKS = 4000  # several chunks
HELD = 2 * TICKS


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "flight"
    odom = wire.OdometryTemplate("map", "uav1")
    random = np.random.default_rng(1)
    with BagWriter(
        path, TOPICS, attachments={"scenario.yaml": b"n: 1\n"}, metadata={"seed": "7"}
    ) as writer:
        for k in range(TICKS):
            writer.write("/uav1/odom", k * 10, odom.encode(k * 10, random.normal(size=13)))
            writer.write("/clock", k * 10 + 5, wire.encode_clock(k))
    return path


@pytest.fixture(scope="module")
def content(flight) -> bytes:
    return (flight / "flight_0.mcap").read_bytes()


def broken(tmp_path: Path, content: bytes) -> Path:
    path = tmp_path / "broken.mcap"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("kind", ["folder", "file", "text"])
def test_read_back(flight, kind):
    path = {"folder": flight, "file": flight / "flight_0.mcap", "text": str(flight)}[kind]
    bag = read_bag(path)
    assert {t.name: (t.type, t.messages) for t in bag.topics.values()} == {
        "/uav1/odom": ("nav_msgs/msg/Odometry", TICKS),
        "/clock": ("rosgraph_msgs/msg/Clock", TICKS),
        "/unused": ("std_msgs/msg/Header", 0),
    }
    assert (bag.start_ns, bag.end_ns) == (0, 10 * TICKS - 5)
    assert bag.metadata == {"seed": "7"}
    assert bag.attachment("scenario.yaml") == b"n: 1\n"
    messages = list(bag.messages())
    assert [m.stamp_ns for m in messages] == [5 * k for k in range(HELD)]
    assert wire.decode_odometry(messages[20].data).stamp_ns == 100


def test_chosen_topics(flight):
    bag = read_bag(flight)
    assert {m.topic for m in bag.messages(["/clock"])} == {"/clock"}
    assert list(bag.messages(["/unused"])) == []
    with pytest.raises(BagError, match="no topic /nope: expected one of /uav1/odom, /clock"):
        bag.messages(["/nope"])


def test_wrong_attachment(flight):
    with pytest.raises(BagError, match=r"no attachment 'x': expected one of scenario\.yaml"):
        read_bag(flight).attachment("x")


def test_out_of_order_is_read_in_order(tmp_path):
    with BagWriter(tmp_path / "x", TOPICS) as writer:
        for stamp in (3, 1, 2):
            writer.write("/clock", stamp, wire.encode_clock(stamp))
    assert [m.stamp_ns for m in read_bag(tmp_path / "x").messages()] == [1, 2, 3]


def test_missing(tmp_path):
    with pytest.raises(BagError, match=r"no such bag$"):
        read_bag(tmp_path / "x")
    (tmp_path / "x.part").mkdir()
    with pytest.raises(BagError, match=r"x\.part exists, a recording that was not completed"):
        read_bag(tmp_path / "x")


def test_folder_without_mcap(tmp_path):
    with pytest.raises(BagError, match=r"no \.mcap file in this folder"):
        read_bag(tmp_path)


def test_folder_with_several(tmp_path):
    (tmp_path / "a.mcap").touch()
    (tmp_path / "b.mcap").touch()
    with pytest.raises(BagError, match=r"a\.mcap, b\.mcap\): name one"):
        read_bag(tmp_path)


def test_empty(tmp_path):
    with pytest.raises(BagError, match="is empty"):
        read_bag(broken(tmp_path, b""))


def test_not_mcap(tmp_path):
    with pytest.raises(BagError, match="is not MCAP: starts with 53 51"):
        read_bag(broken(tmp_path, b"SQLite format 3\0" + bytes(100)))


def test_no_messages(tmp_path):
    with BagWriter(tmp_path / "x", TOPICS):
        pass
    with pytest.raises(BagError, match="holds no message"):
        read_bag(tmp_path / "x")


@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_cut(tmp_path, content, share):
    size = max(8, int(len(content) * share))
    path = broken(tmp_path, content[:size])
    with pytest.raises(BagError, match=r"is cut.* (\d+) messages are readable"):
        read_bag(path)
    if share < 0.1:
        with pytest.raises(BagError, match="holds no message"):
            read_bag(path, salvage=True)
        return
    bag = read_bag(path, salvage=True)
    assert f"{path.name}: its end is missing" in find_problems(bag)
    held = sum(topic.messages for topic in bag.topics.values())
    assert [m.stamp_ns for m in bag.messages()] == [5 * k for k in range(held)]
    assert 0 < held <= HELD
    assert bag.attachment("scenario.yaml") == b"n: 1\n"
    assert {m.topic for m in bag.messages(["/clock"])} == {"/clock"}


def test_damaged_chunk(tmp_path, content):
    damaged = bytearray(content)
    damaged[len(damaged) // 2] ^= 0xFF
    path = broken(tmp_path, bytes(damaged))
    with pytest.raises(BagError, match="is damaged"):
        list(read_bag(path).messages())
    readable = [m.stamp_ns for m in read_bag(path, salvage=True).messages()]
    assert 0 < len(readable) < HELD
    gaps = [(a, b) for a, b in pairwise(readable) if b != a + 5]
    assert len(gaps) == 1, "one chunk is missing, and all after it is there"
    assert (readable[0], readable[-1]) == (0, 5 * (HELD - 1))


def test_crc(tmp_path):
    """Without compression only the checksum can tell."""
    with BagWriter(tmp_path / "x", TOPICS, compression=CompressionType.NONE) as writer:
        for k in range(100):
            writer.write("/clock", k, wire.encode_clock(k))
    file = tmp_path / "x" / "x_0.mcap"
    content = bytearray(file.read_bytes())
    content[content.find(wire.encode_clock(50)) + 5] ^= 1
    file.write_bytes(content)
    with pytest.raises(BagError, match="is damaged"):
        list(read_bag(tmp_path / "x").messages())


@given(data=st.data())
def test_damage_anywhere_is_said_in_words(tmp_path_factory, data):
    """Flipped and missing bytes: messages, or a BagError; never another exception."""
    folder = tmp_path_factory.mktemp("fuzz")
    with BagWriter(folder / "x", TOPICS[1:], metadata={"a": "b"}) as writer:
        for k in range(10):
            writer.write("/clock", k, wire.encode_clock(k))
    content = bytearray((folder / "x" / "x_0.mcap").read_bytes())
    for at in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=3)):
        content[at] ^= data.draw(st.integers(1, 255))
    size = data.draw(st.one_of(st.just(len(content)), st.integers(0, len(content))))
    path = broken(folder, bytes(content[:size]))
    for salvage in (False, True):
        try:
            bag = read_bag(path, salvage=salvage)
            list(bag.messages())
            for name in bag.attachments:
                bag.attachment(name)
        except BagError as error:
            assert str(path) in str(error)
