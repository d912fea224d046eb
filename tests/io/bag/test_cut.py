"""Spans of a bag, and several bags as one."""

from __future__ import annotations

from pathlib import Path

import pytest

from ptnsbc_io.bag import BagError, BagWriter, TopicInfo, read_bag
from ptnsbc_io.bag.cut import merge, trim
from ptnsbc_io.bag.reader import find_problems
from ptnsbc_io.wire import HeaderTemplate

HEADER = "std_msgs/msg/Header"
EPOCH = TopicInfo("/formation/epoch", HEADER, durability="transient_local", depth=1)


def message(k: int) -> bytes:
    return HeaderTemplate(f"m{k}").encode(k)


def write(
    path: Path, topic: str, times: range, scenario: bytes = b"n: 1\n", kind: str = HEADER
) -> Path:
    topics = [EPOCH, TopicInfo(topic, kind)]
    attached = {"scenario.yaml": scenario}
    with BagWriter(path, topics, attachments=attached, metadata={"seed": "7"}) as bag:
        bag.write(EPOCH.name, times[0], message(0))
        for k in times:
            bag.write(topic, k, message(k))
    return path


def test_a_span_keeps_bytes_times_and_what_was_latched(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole", "/a", range(100, 200, 10))
    assert trim(whole, tmp_path / "part", 130, 160) == 5
    part = read_bag(tmp_path / "part")
    assert find_problems(part) == []
    assert [(m.topic, m.stamp_ns, m.data) for m in part.messages()] == [
        (EPOCH.name, 100, message(0)),
        *(("/a", k, message(k)) for k in (130, 140, 150, 160)),
    ]
    assert part.attachment("scenario.yaml") == b"n: 1\n" and part.metadata == {"seed": "7"}
    assert part.topics[EPOCH.name].offered_qos == read_bag(whole).topics[EPOCH.name].offered_qos


def test_an_empty_span_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole", "/a", range(100, 200, 10))
    with pytest.raises(BagError, match="no message from 2e-07 s to 3e-07 s after its first"):
        trim(whole, tmp_path / "part", 300, 400)
    assert [path.name for path in tmp_path.iterdir()] == ["whole"]
    trim(whole, tmp_path / "part", 100, 400)
    with pytest.raises(BagError, match="exists"):
        trim(whole, tmp_path / "part", 100, 400)


def test_two_spans_merge_to_the_whole(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole", "/a", range(100, 200, 10))
    trim(whole, tmp_path / "one", 100, 140)
    other = write(tmp_path / "other", "/b", range(105, 205, 10))
    assert merge([tmp_path / "one", other], tmp_path / "both") == 6 + 11
    both = read_bag(tmp_path / "both")
    assert find_problems(both) == []
    stamps = [m.stamp_ns for m in both.messages()]
    assert stamps == sorted(stamps) and len(stamps) == 17
    assert set(both.topics) == {EPOCH.name, "/a", "/b"}


def test_bags_of_two_flights_are_refused(tmp_path: Path) -> None:
    one = write(tmp_path / "one", "/a", range(10))
    for name, more, words in (
        ("two", {"scenario": b"n: 2\n"}, "its scenario.yaml is not that of the other bag"),
        ("three", {"kind": "rosgraph_msgs/msg/Clock"}, "expected one type for a topic"),
    ):
        two = write(tmp_path / name, "/a", range(10), **more)
        with pytest.raises(BagError, match=words):
            merge([one, two], tmp_path / "both")
    assert not (tmp_path / "both").exists()
