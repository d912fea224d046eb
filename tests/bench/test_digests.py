"""Digests of a bag: one for each topic, and another one after a change of a single bit."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

sys.path.insert(0, str(Path(__file__).parents[2]))  # the benchmark is in no wheel

from bench.digests import topic_digests
from ptnsbc_io.bag import BagWriter, declare

SAMPLE = Path(__file__).parents[2] / "bags" / "sample"


@pytest.mark.slow
def test_every_topic_of_a_bag_has_a_digest(tmp_path):
    found = topic_digests(SAMPLE)
    with next(SAMPLE.glob("*.mcap")).open("rb") as stream:
        topics = {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}
    assert set(found) == topics
    copy = shutil.copytree(SAMPLE, tmp_path / "copy")
    assert topic_digests(copy) == found


def test_stamps_and_bytes_count(tmp_path):
    def digest(name, stamp_ns, data):
        with BagWriter(tmp_path / name, [declare("/a", "std_msgs/msg/Header")]) as writer:
            writer.write("/a", stamp_ns, data)
        return topic_digests(tmp_path / name)["/a"]

    first = digest("one", 5, b"\0\1\0\0\1")
    assert first == digest("same", 5, b"\0\1\0\0\1")
    assert len({first, digest("later", 6, b"\0\1\0\0\1"), digest("bit", 5, b"\0\1\0\0\0")}) == 3
