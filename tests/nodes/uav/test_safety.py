"""What concerns a UAV process, and the state that follows."""

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.comm.diagnostics import SafetyState, assess
from ptnsbc_nodes.uav.safety import PlannerSight, planner_concerns


@pytest.mark.parametrize(
    ("sight", "state", "reason"),
    [
        ({}, SafetyState.NOMINAL, ""),
        ({"waiting_for": "/a", "flying": False}, SafetyState.NOMINAL, "waiting for /a"),
        ({"waiting_for": "/a"}, SafetyState.DEGRADED, "waiting for /a"),
        ({"near_stale": True}, SafetyState.DEGRADED, "near objects are stale: slow"),
        ({"silent_estimates": "uav2"}, SafetyState.DEGRADED, "estimates left out: uav2"),
        ({"missed_ticks": 3}, SafetyState.DEGRADED, "3 ticks missed since the last status"),
        ({"intruder": "/b: again"}, SafetyState.DEGRADED, "/b: again"),
        ({"holding": True}, SafetyState.HOLD_CLEAR, "holding"),
        ({"holding": True, "slots_fault": "no slots"}, SafetyState.HOLD_CLEAR, "no slots"),
        ({"inactive": True, "holding": True}, SafetyState.STOP, "inactive"),
        (
            {"odometry_stale": True, "clock_offset": "clock 0.2 s ahead"},
            SafetyState.STOP,
            "own odometry is stale: no setpoints; clock 0.2 s ahead",
        ),
    ],
)
def test_what_a_uav_notices_and_its_state(sight, state, reason):
    found = assess(planner_concerns(PlannerSight(**sight)))
    assert (found.state, found.reason) == (state, reason)
