"""A track on the disk is the one that would be in memory, whatever order its messages came in."""

from __future__ import annotations

import errno
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.verdict import Track
from ptnsbc_tools.reading import disk_track
from ptnsbc_tools.reading.disk_track import SampleFile, TrackWriter

STAMPS = st.lists(st.integers(-5, 60), min_size=1, max_size=60) | st.lists(
    st.integers(-(2**40), 2**40), min_size=1, max_size=60, unique=True
).map(sorted)


def written(stamps: list[int], width: int = 3) -> tuple[Track, Track]:
    """A track on the disk and what it should hold: of two with one stamp the last, by stamp."""
    writer = TrackWriter(SampleFile())
    rows: dict[int, list[float]] = {}
    empty = len(stamps) > 1 and not any(stamps)
    for number, stamp in enumerate(stamps):
        values = [float(100 * number + column) for column in range(width)]
        writer.add(stamp, 1000 - number, np.array(values))
        rows[1000 - number if empty else stamp] = values
    order = sorted(rows)
    expected = Track(np.array(order), np.array([rows[stamp] for stamp in order]))
    return writer.track(), expected


@pytest.mark.parametrize("rows", [1, 4, 1024])
@given(stamps=STAMPS, data=st.data())
def test_a_track_on_the_disk_is_that_in_memory(rows, stamps, data):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(disk_track, "_ROWS", rows)
        track, expected = written(stamps)
        assert (track.size, track.first_ns, track.last_ns) == (
            expected.size,
            expected.first_ns,
            expected.last_ns,
        )
        first, end = sorted(data.draw(st.tuples(*2 * [st.integers(0, expected.size)])))
        found, wanted = track.rows(first, end), expected.rows(first, end)
        np.testing.assert_array_equal(found.t_ns, wanted.t_ns)
        np.testing.assert_array_equal(found.values, wanted.values)
        t_ns = data.draw(st.integers(-70, 70) | st.sampled_from(expected.t_ns.tolist()))
        for side in ("left", "right"):
            assert track.index(t_ns, side) == expected.index(t_ns, side)
        grid = np.array(sorted(data.draw(st.lists(st.integers(-70, 70), min_size=1, max_size=9))))
        np.testing.assert_array_equal(track.at(grid), expected.at(grid))


def test_empty_headers_count_from_when_they_were_logged():
    track, _ = written([0, 0, 0])
    assert track.rows(0, 3).t_ns.tolist() == [998, 999, 1000]


def test_a_single_sample_may_have_the_time_zero():
    track, _ = written([0])
    assert (track.size, track.first_ns) == (1, 0)


def test_no_room_is_said_in_one_line(monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(PtnsbcError, match=r"No space left on device: .* TMPDIR"):
        written([1, 2, 3])
