"""Fewer points, the same peaks."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ptnsbc_tools.plotting.thin import Thinner, thin

CURVES = arrays(
    np.float64,
    st.integers(2, 400),
    elements=st.floats(-1e3, 1e3) | st.just(float("nan")),
)


@given(CURVES, st.integers(8, 60))
def test_ends_peaks_and_gaps_stay(values, points):
    t = np.arange(values.size, dtype=np.float64)
    kept = thin(t, values, points)
    assert kept.t.size == kept.values.size <= max(points, 8)
    assert (kept.t[0], kept.t[-1]) == (0, values.size - 1)
    assert (np.diff(kept.t) > 0).all()
    np.testing.assert_array_equal(values[kept.t.astype(int)], kept.values)
    if np.isfinite(values).any():
        assert np.nanmax(kept.values) == np.nanmax(values)
        assert np.nanmin(kept.values) == np.nanmin(values)
    assert np.isnan(kept.values).any() == np.isnan(values).any()


def test_a_needle_keeps_its_height_and_its_time():
    t = np.linspace(0, 60, 6001)
    values = np.zeros(6001)
    values[1234] = 7.0
    kept = thin(t, values, 200)
    assert kept.values.max() == 7.0
    assert kept.t[kept.values.argmax()] == t[1234]


def test_what_is_short_is_left_alone():
    t, values = np.arange(5.0), np.arange(5.0)
    assert thin(t, values, 8).t is t


@given(CURVES, st.integers(8, 60), st.data())
def test_in_pieces_as_at_once(values, points, data):
    t = np.arange(values.size, dtype=np.float64)
    cuts = sorted(data.draw(st.lists(st.integers(0, values.size), max_size=6)))
    thinner = Thinner(values.size, points)
    for begin, end in zip([0, *cuts], [*cuts, values.size], strict=True):
        thinner.add(t[begin:end], values[begin:end])
    whole = thin(t, values, points)
    np.testing.assert_array_equal(thinner.points().t, whole.t)
    np.testing.assert_array_equal(thinner.points().values, whole.values)
