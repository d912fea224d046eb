"""Limits of setpoints: the lower of two counts, and no setpoint leads out of the fence."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pymavlink")

from ptnsbc_io.mavlink.autopilots import SetpointLimits, limits
from ptnsbc_nodes.bridge.setpoint.setpoint_guard import SetpointGuard, allowed
from ptnsbc_sim.scenario.mavlink import Geofence, VehicleLimits

LIMITS = SetpointLimits(5.0, 3.0, 1.5, 5.0, 0.6)
BOX = Geofence(box_min_m=[-5, -5, 0], box_max_m=[5, 5, 10])
STILL = np.zeros(3)


def test_the_fence_slows_down_and_then_lands():
    guard = SetpointGuard(BOX, LIMITS)
    inward = np.array([-1.0, 0.0, 0.0])
    near = np.array([4.9, 0.0, 5.0])
    assert guard.velocity(inward, near, STILL) == pytest.approx(inward)
    assert guard.velocity(-inward, near, STILL) == pytest.approx([0.1, 0, 0])
    assert guard.clamped["fence"] == 1
    assert guard.breach(np.array([5.5, 0, 5.0]), STILL) == ""
    assert "x = 6.1 m" in guard.breach(np.array([6.1, 0, 5.0]), STILL)
    ring = SetpointGuard(Geofence(radius_m=10), LIMITS)
    assert ring.velocity(np.array([0, 3.0, 1.0]), np.array([0, 9.5, 2.0]), STILL) == pytest.approx(
        [0, 0.5, 1.0]
    )
    assert "11.5 m of 10 m" in ring.breach(np.array([0, 11.5, 2.0]), STILL)
    assert ring.position(np.array([0, 20.0, 2.0])) == pytest.approx([0, 10, 2])


def test_outside_the_fence_every_setpoint_leads_inwards():
    guard = SetpointGuard(BOX, LIMITS)
    outside = np.array([5.6, 0.0, 10.4])
    for wish in (STILL, np.array([2.0, 1.0, 1.0])):
        out = guard.velocity(wish, outside, STILL)
        assert out[0] == pytest.approx(-0.6)
        assert out[2] == pytest.approx(-0.4)
    ring = SetpointGuard(Geofence(radius_m=10), LIMITS)
    out = ring.velocity(STILL, np.array([6.6, 8.8, 2.0]), STILL)
    assert out == pytest.approx([-0.6, -0.8, 0.0])


def test_the_predicted_path_counts_not_only_the_place():
    guard = SetpointGuard(BOX, LIMITS)
    place, fast = np.array([4.5, 0.0, 5.0]), np.array([3.0, 0.0, 0.0])
    assert guard.velocity(fast, place, STILL)[0] == pytest.approx(0.5)
    assert guard.velocity(fast, place, fast)[0] == pytest.approx(-1.0)  # at 6 m in half a second
    assert guard.breach(place, fast) == ""
    assert guard.breach(place, 2 * fast) == "outside the geofence in 0.5 s: x = 7.5 m"


def test_the_slack_is_the_scenarios():
    wide = SetpointGuard(BOX.model_copy(update={"slack_m": 3.0}), LIMITS)
    none = SetpointGuard(BOX.model_copy(update={"slack_m": 0.0}), LIMITS)
    place = np.array([7.0, 0.0, 5.0])
    assert wide.breach(place, STILL) == ""
    assert none.breach(np.array([5.01, 0.0, 5.0]), STILL) != ""


def test_a_drift_does_not_carry_a_vehicle_out_of_the_fence():
    """A velocity loop with a lag of 0.5 s and a drift of 0.3 m/s that no estimate shows."""
    guard = SetpointGuard(BOX, LIMITS)
    place, moving, dt, worst = np.array([4.0, 0.0, 5.0]), STILL.copy(), 0.02, 0.0
    for _ in range(3000):
        setpoint = guard.velocity(np.array([2.0, 0.0, 0.0]), place, moving)
        moving = moving + dt / 0.5 * (setpoint - moving)
        place = place + dt * (moving + np.array([0.3, 0.0, 0.0]))
        worst = max(worst, place[0])
        assert guard.breach(place, moving) == ""
    # There the push equals the drift: 0.3 m/s by 1 1/s, and 0.5 s of a motion inwards that is none.
    assert place[0] == pytest.approx(5.0 + 0.3 + 0.5 * 0.3, abs=0.01)
    assert worst < place[0] + 0.05


vectors = st.tuples(*[st.floats(-50, 50)] * 3).map(np.array)


@given(vectors, vectors)
def test_no_setpoint_leads_out_of_the_fence_or_beyond_the_limits(velocity, position):
    guard = SetpointGuard(Geofence(radius_m=6, box_min_m=[-5, -5, 0], box_max_m=[5, 5, 10]), LIMITS)
    out = guard.velocity(velocity, position, STILL)
    assert math.hypot(out[0], out[1]) <= 5.0 + 1e-6
    assert -1.5 - 1e-6 <= out[2] <= 3.0 + 1e-6
    ahead = position + out  # one second on, at this speed
    for axis in range(3):
        if (-5, -5, 0)[axis] <= position[axis] <= (5, 5, 10)[axis]:
            assert (-5, -5, 0)[axis] - 1e-6 <= ahead[axis] <= (5, 5, 10)[axis] + 1e-6


def test_the_lower_of_two_limits_counts():
    px4 = limits({"MPC_XY_VEL_MAX": 2.0, "MPC_Z_VEL_MAX_UP": 8.0, "MPC_TILTMAX_AIR": 20.0})
    found = allowed(VehicleLimits(), px4)
    assert found[:4] == (2.0, 3.0, 1.5, 5.0)
    assert found.tilt_rad == pytest.approx(math.radians(20.0))
    assert found.planner_m_s == 2.0
    slower = limits({"WP_SPD": 2.5, "WP_SPD_DN": 1.0, "ATC_ANGLE_MAX": 30.0})
    assert allowed(VehicleLimits(), slower).horizontal_m_s == 2.5
