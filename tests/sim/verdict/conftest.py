"""Flights whose positions are known in closed form."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from synthetic_flights import counters, flight, thinned

from ptnsbc_sim.verdict import Recording, Track


@pytest.fixture
def without() -> Callable[..., Track]:
    return thinned


@pytest.fixture
def fly() -> Callable[..., Recording]:
    return flight


@pytest.fixture
def count() -> Callable[..., Track]:
    return counters
