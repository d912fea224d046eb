"""Bags from Python: a part, parts as one again, and the re-run, as the commands give them."""

from __future__ import annotations

from pathlib import Path

import pytest

import ptnsbc
from ptnsbc_io.bag import BagError, read_bag
from ptnsbc_tools.replay.rerun import EQUAL

SAMPLE = Path(__file__).parents[3] / "bags" / "sample"


def test_a_bag_cut_in_two_and_merged_has_its_messages_again(tmp_path: Path) -> None:
    whole = read_bag(SAMPLE)
    half_s = (whole.end_ns - whole.start_ns) * 0.5e-9
    first = ptnsbc.trim(SAMPLE, tmp_path / "first", end_s=half_s)
    second = ptnsbc.trim(SAMPLE, tmp_path / "second", half_s + 1e-9)
    total = sum(topic.messages for topic in whole.topics.values())
    count = ptnsbc.merge([tmp_path / "first", tmp_path / "second"], tmp_path / "both")
    assert first + second == count and min(first, second) > 0
    latched = count - total  # the second part keeps what latched topics said before it
    found = read_bag(tmp_path / "both")
    assert 0 <= latched < 10 and set(found.topics) == set(whole.topics)
    assert (found.start_ns, found.end_ns) == (whole.start_ns, whole.end_ns)


def test_one_bag_is_not_merged(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="sample: expected two or more to merge"):
        ptnsbc.merge([SAMPLE], tmp_path / "both")
    with pytest.raises(BagError, match=r"sample_0\.mcap is given twice: expected different bags"):
        ptnsbc.merge([SAMPLE, SAMPLE / "sample_0.mcap"], tmp_path / "both")


def test_a_span_outside_the_bag_is_refused_in_seconds(tmp_path: Path) -> None:
    words = "no message from 100 s to 7.99 s after its first one: expected times from 0 s to 7.99 s"
    with pytest.raises(BagError, match=words):
        ptnsbc.trim(SAMPLE, tmp_path / "part", 100.0)


@pytest.mark.slow
def test_the_sample_bag_runs_again_byte_for_byte() -> None:
    found = ptnsbc.rerun(SAMPLE, progress=False)
    assert (found.verdict, found.first) == (EQUAL, None)
