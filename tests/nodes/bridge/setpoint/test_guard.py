"""Limits of setpoints: the lower of two counts, and no setpoint leads out of the fence."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pymavlink")

from ptnsbc_io.mavlink.autopilots import limits
from ptnsbc_nodes.bridge.setpoint.guard import SetpointGuard, SetpointLimits, allowed
from ptnsbc_sim.scenario.mavlink import Geofence, VehicleLimits

LIMITS = SetpointLimits(5.0, 3.0, 1.5, 5.0, 0.6)
BOX = Geofence(box_min_m=[-5, -5, 0], box_max_m=[5, 5, 10])


def test_the_fence_slows_down_and_then_lands():
    guard = SetpointGuard(BOX, LIMITS)
    inward = np.array([-1.0, 0.0, 0.0])
    near = np.array([4.9, 0.0, 5.0])
    assert guard.velocity(inward, near) == pytest.approx(inward)
    assert guard.velocity(-inward, near) == pytest.approx([0.1, 0, 0])
    assert guard.velocity(-inward, np.array([5.2, 0.0, 5.0])) == pytest.approx([0, 0, 0])
    assert guard.clamped["fence"] == 2
    assert guard.breach(np.array([5.5, 0, 5.0])) == ""
    assert "x = 6.1 m" in guard.breach(np.array([6.1, 0, 5.0]))
    ring = SetpointGuard(Geofence(radius_m=10), LIMITS)
    assert ring.velocity(np.array([0, 3.0, 1.0]), np.array([0, 9.5, 2.0])) == pytest.approx(
        [0, 0.5, 1.0]
    )
    assert "11.5 m of 10 m" in ring.breach(np.array([0, 11.5, 2.0]))
    assert ring.position(np.array([0, 20.0, 2.0])) == pytest.approx([0, 10, 2])


vectors = st.tuples(*[st.floats(-50, 50)] * 3).map(np.array)


@given(vectors, vectors)
def test_no_setpoint_leads_out_of_the_fence_or_beyond_the_limits(velocity, position):
    guard = SetpointGuard(Geofence(radius_m=6, box_min_m=[-5, -5, 0], box_max_m=[5, 5, 10]), LIMITS)
    out = guard.velocity(velocity, position)
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
    old = limits({"WPNAV_SPEED": 400.0, "WPNAV_SPEED_DN": 100.0, "ANGLE_MAX": 3000.0})
    new = limits({"WP_SPD": 4.0, "WP_SPD_DN": 1.0, "ATC_ANGLE_MAX": 30.0})
    assert old == new
    assert allowed(VehicleLimits(), old).horizontal_m_s == 4.0
