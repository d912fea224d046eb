"""Missing messages of a flight of real vehicles, whose bridges count the messages that they sent."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ptnsbc_sim.verdict import Recording, Series, verdict_on

Fly = Callable[..., Recording]
EVERY = 2  # 50 Hz of a vehicle in a scenario with 100 Hz of control


@pytest.fixture
def bridged(fly: Fly, without: Callable[..., Any]) -> Fly:
    """A flight at the vehicle's rate, which begins 1 s before the epoch; `gone` are messages of UAV 2 not recorded."""

    def make(*gone: int) -> Recording:
        whole = fly(seconds=13.0)
        odd = [tick for tick in range(1300) if tick % EVERY]
        slow = {uav: without(series, *odd) for uav, series in whole.odometry.items()}
        inputs = {uav: without(series, *odd) for uav, series in whole.wrench.items()}
        stamps = slow[1].t_ns[4::10]  # five times a second
        counts = np.arange(5.0, 5.0 + 10.0 * stamps.size, 10.0)[:, None]
        sent = {uav: Series(stamps, counts) for uav in slow}
        slow[2] = without(slow[2], *gone)
        inputs[2] = without(inputs[2], *gone)
        epochs = ((1_000_000_000, "form"),)
        return fly(seconds=13.0, odometry=slow, wrench=inputs, sent=sent, epochs=epochs)

    return make


def test_a_vehicles_own_rate_is_no_loss(bridged: Fly) -> None:
    found = verdict_on(bridged())
    assert [one.missing for one in found.uavs] == [0] * 5
    assert [one.missing for one in found.efforts] == [0] * 5


def test_what_was_sent_and_not_recorded_is_missing(bridged: Fly) -> None:
    found = verdict_on(bridged(100, 101, 102, 300))
    assert [one.missing for one in found.uavs] == [0, 4, 0, 0, 0]
    assert [one.missing for one in found.efforts] == [0, 4, 0, 0, 0]


def test_what_is_lost_before_the_epoch_does_not_count(bridged: Fly) -> None:
    assert verdict_on(bridged(3, 4, 30)).uavs[1].missing == 0
