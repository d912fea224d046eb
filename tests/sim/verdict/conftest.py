"""Flights whose positions are known in closed form."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from synthetic_flights import counters, flight, thinned

from ptnsbc_sim.verdict import Recording, Series


@pytest.fixture
def without() -> Callable[..., Series]:
    return thinned


@pytest.fixture
def fly() -> Callable[..., Recording]:
    return flight


@pytest.fixture
def count() -> Callable[..., Series]:
    return counters
