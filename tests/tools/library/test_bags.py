"""Bags from Python: a part, and the re-run, as the commands give them."""

from __future__ import annotations

from pathlib import Path

import pytest

import ptnsbc
from ptnsbc_io.bag import BagError, read_bag
from ptnsbc_tools.replay.rerun import EQUAL

SAMPLE = Path(__file__).parents[3] / "bags" / "sample"


def test_a_bag_cut_in_two_has_its_messages_in_its_parts(tmp_path: Path) -> None:
    whole = read_bag(SAMPLE)
    half_s = (whole.end_ns - whole.start_ns) * 0.5e-9
    first = ptnsbc.trim(SAMPLE, tmp_path / "first", end_s=half_s)
    second = ptnsbc.trim(SAMPLE, tmp_path / "second", half_s + 1e-9)
    latched = first + second - sum(topic.messages for topic in whole.topics.values())
    assert 0 <= latched < 10 and min(first, second) > 0  # what latched topics said is in both
    assert set(read_bag(tmp_path / "second").topics) == set(whole.topics)


def test_a_span_outside_the_bag_is_refused_in_seconds(tmp_path: Path) -> None:
    words = "no message from 100 s to 7.99 s after its first one: expected times from 0 s to 7.99 s"
    with pytest.raises(BagError, match=words):
        ptnsbc.trim(SAMPLE, tmp_path / "part", 100.0)


@pytest.mark.slow
def test_the_sample_bag_runs_again_byte_for_byte() -> None:
    found = ptnsbc.rerun(SAMPLE, progress=False)
    assert (found.verdict, found.first) == (EQUAL, None)
