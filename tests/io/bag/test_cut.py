"""Spans of a bag."""

from __future__ import annotations

from pathlib import Path

import pytest

from ptnsbc_io.bag import BagError, BagWriter, TopicInfo, read_bag
from ptnsbc_io.bag.cut import trim
from ptnsbc_io.bag.reader import find_problems
from ptnsbc_io.wire import HeaderTemplate

HEADER = "std_msgs/msg/Header"
EPOCH = TopicInfo("/formation/epoch", HEADER, durability="transient_local", depth=1)


def message(k: int) -> bytes:
    return HeaderTemplate(f"m{k}").encode(k)


def write(path: Path, topic: str, times: range) -> Path:
    topics = [EPOCH, TopicInfo(topic, HEADER)]
    attached = {"scenario.yaml": b"n: 1\n"}
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
