"""Nanoseconds and seconds, one by one and in arrays."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.nanoseconds import SECOND_NS, nanoseconds, seconds


@given(st.integers(-(10**15), 10**15))
def test_they_are_the_inverse_of_each_other(ns: int) -> None:
    assert nanoseconds(seconds(ns)) == ns
    assert seconds(np.array([ns]))[0] == seconds(ns)


def test_a_second_has_so_many() -> None:
    assert nanoseconds(1.0) == SECOND_NS
    assert nanoseconds(0.1) == SECOND_NS // 10
