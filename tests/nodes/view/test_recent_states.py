"""States of vehicles that arrive one after the other, at one common instant."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy")

from ptnsbc_io.wire import HeaderFields, Stamped
from ptnsbc_nodes.view.flight_state import FlightState
from ptnsbc_nodes.view.recent_states import RecentStates
from ptnsbc_sim.scenario import load_scenario

PERIOD_NS = 10_000_000
MS = 1_000_000


def told(stamp_ns: int, position: tuple[float, float, float]) -> Stamped:
    values = np.zeros(13)
    values[:3], values[6] = position, 1.0
    return Stamped(stamp_ns, values)


def test_positions_are_interpolated_at_what_all_have_reached() -> None:
    states = RecentStates()
    assert (states.common_ns, states.at(0)) == (-1, {})
    for tick in range(4):
        states.add(1, told(tick * PERIOD_NS, (1.0 * tick, 0.0, 0.0)))
    for stamp_ns in (3 * MS, 24 * MS, 14 * MS):  # the last was overtaken
        states.add(2, told(stamp_ns, (0.0, 1e-6 * stamp_ns, 0.0)))
    assert states.common_ns == 24 * MS
    found = states.at(24 * MS)
    np.testing.assert_allclose(found[1][:3], (2.4, 0.0, 0.0))
    np.testing.assert_allclose(found[2][:3], (0.0, 24.0, 0.0))


def test_nobody_waits_for_a_silent_vehicle() -> None:
    states = RecentStates()
    states.add(2, told(0, (5.0, 0.0, 0.0)))
    for tick in range(200):
        states.add(1, told(tick * PERIOD_NS, (0.0, 0.0, 0.0)))
    assert states.common_ns == 199 * PERIOD_NS
    assert states.at(states.common_ns)[2][0] == 5.0
    states.add(2, told(200 * PERIOD_NS, (6.0, 0.0, 0.0)))
    assert states.common_ns == 199 * PERIOD_NS
    states.add(1, told(0, (7.0, 0.0, 0.0)))  # time has begun anew
    assert states.at(0)[1][0] == 7.0


def test_errors_of_a_moving_formation_do_not_depend_on_the_order_of_messages() -> None:
    """UAVs in place move at 2 m/s; between the first and the last message of a tick the errors stay zero."""
    scenario = load_scenario("paper_5")
    state = FlightState(scenario, lambda: 0.0)
    state.on_leg(HeaderFields(0, "form"))
    for tick in range(6):
        stamp_ns = tick * PERIOD_NS
        moved = np.array([2e-9 * stamp_ns, 0.0, 0.0])
        for uav in scenario.uav_ids:
            state.on_odometry(uav, told(stamp_ns, tuple(moved + scenario.offset(uav))))
            errors = [
                one["error"] for one in state.frame()["uavs"] if one["id"] != scenario.leader.id
            ]
            assert tick == 0 or errors == [0.0] * len(scenario.followers)
