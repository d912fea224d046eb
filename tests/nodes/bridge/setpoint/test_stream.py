"""Setpoints as they leave: clamps, fence, feed-forward, holding, attitude targets on the wire."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pymavlink")

from ptnsbc_core.kinematics import quaternion_from_euler, rotation_from_quaternion
from ptnsbc_io.mavlink.autopilots import ARDUPILOT, GENERIC, PX4, advice, limits, refusal
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_nodes.bridge.controller import PublishedOdometry, SetpointReply
from ptnsbc_nodes.bridge.procedure.steps import Stream
from ptnsbc_nodes.bridge.setpoint.guard import SetpointGuard, SetpointLimits, allowed
from ptnsbc_nodes.bridge.setpoint.hover_thrust import HoverThrust
from ptnsbc_nodes.bridge.setpoint.messages import Setpoints
from ptnsbc_nodes.bridge.setpoint.stream import SetpointStream
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.mavlink import Geofence, VehicleLimits

LIMITS = SetpointLimits(5.0, 3.0, 1.5, 5.0, 0.6)
BOX = Geofence(box_min_m=[-5, -5, 0], box_max_m=[5, 5, 10])


@pytest.fixture(scope="module")
def config():
    return agent_config(load_scenario("experiment_4"), 1)


def state(position=(0, 0, 3), euler=(0, 0, 0), velocity=(0, 0, 0), rates=(0, 0, 0)):
    odometry = np.zeros(13)
    odometry[0:3] = position
    odometry[3:7] = quaternion_from_euler(np.array(euler, dtype=float))
    odometry[7:10], odometry[10:13] = velocity, rates
    return odometry


def make(config, kind="velocity", autopilot=PX4, fence=None, feed_forward=False):
    guard = SetpointGuard(fence or Geofence(), LIMITS)
    hover = HoverThrust(0.5, 9.81)
    return SetpointStream(
        autopilot, kind, config, guard, Setpoints(autopilot, 3), hover, feed_forward, 3.0
    )


def send(stream, carried, now_s=1.0, odometry=None, values=None, offset=(0, 0, 0), armed=True):
    odometry = state() if odometry is None else odometry
    wanted = None
    if values is not None:
        wanted = SetpointReply(
            np.array(values, dtype=float), PublishedOdometry(now_s, now_s, odometry)
        )
    return stream.message(carried, now_s, odometry, np.array(offset, float), wanted, armed, 5.0)


def test_a_velocity_setpoint_is_north_east_down_with_a_heading(config):
    message = send(make(config), Stream.PLANNER, values=[1, 2, 0.5, 0, 0, 0])
    assert (message.target_system, message.target_component) == (3, 1)
    assert message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED
    assert message.type_mask == 0x09C7
    assert (message.vx, message.vy, message.vz) == (2.0, 1.0, -0.5)
    assert message.yaw == pytest.approx(math.pi / 2)


def test_speeds_are_clamped_and_counted(config):
    stream = make(config)
    message = send(stream, Stream.PLANNER, values=[30, 40, -9, 0, 0, 0])
    assert (message.vx, message.vy, message.vz) == pytest.approx((4.0, 3.0, 1.5))
    assert stream._guard.clamped == {"horizontal": 1, "down": 1}


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
    assert ring.place(np.array([0, 20.0, 2.0])) == pytest.approx([0, 10, 2])


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


def test_what_a_lab_should_know_before_it_flies():
    warned = list(advice({"COM_OBL_RC_ACT": 0.0, "COM_OF_LOSS_T": 0.05, "NAV_DLL_ACT": 2.0}, 50))
    assert [line.partition("=")[0] for line in warned] == [
        "COM_OBL_RC_ACT", "COM_OF_LOSS_T", "NAV_DLL_ACT"
    ]  # fmt: skip
    assert list(advice({"COM_OBL_RC_ACT": 5.0, "COM_OF_LOSS_T": 1.0}, 50)) == []
    assert "GUID_OPTIONS=8" in refusal(ARDUPILOT, {"GUID_OPTIONS": 0.0}, "attitude")
    assert refusal(ARDUPILOT, {"GUID_OPTIONS": 8.0}, "attitude") is None
    assert "attitude targets only" in refusal(GENERIC, {}, "velocity")


def test_holding_is_a_point_in_the_vehicles_own_frame(config):
    stream = make(config)
    there = state((31, 2, 8))
    message = send(stream, Stream.HOLD, 1.0, there, offset=(30, 0, 1))
    assert message.type_mask == 0x09F8
    assert (message.x, message.y, message.z) == pytest.approx((2, 1, -7))
    drifted = send(stream, Stream.HOLD, 1.1, state((32, 2, 8)), offset=(30, 0, 1))
    assert drifted.y == pytest.approx(1)  # zero velocity would have let it go
    on_ground = send(stream, Stream.HOLD, 1.2, state((33, 2, 8)), offset=(30, 0, 1), armed=False)
    assert on_ground.y == pytest.approx(3)


def test_take_off_is_a_target_that_climbs_at_a_walking_pace(config):
    stream = make(config)
    send(stream, Stream.HOLD, 1.0, state((1, 2, 0.5)), armed=False)
    heights, height = [], 0.5
    for n in range(300):
        message = send(stream, Stream.CLIMB, 1.0 + 0.02 * n, state((1.2, 2, height)))
        heights.append(-message.z)
        height = min(max(height, -message.z - 0.3), 3.5)
    assert heights[0] < 0.6
    assert max(np.diff(heights)) <= 0.021
    assert heights[-1] == pytest.approx(3.5)  # 3 m above where it stood
    assert message.y == pytest.approx(1.2)


def test_take_off_turns_to_the_heading_with_which_the_formation_begins(config):
    stream = make(config)
    send(stream, Stream.HOLD, 1.0, state(euler=(0, 0, 3.0)), armed=False)
    assert stream.turned(state(euler=(0, 0, 3.0)))  # not on its way yet
    headings = []
    for n in range(300):
        message = send(stream, Stream.CLIMB, 1.0 + 0.02 * n, state(euler=(0, 0, 3.0)))
        headings.append(math.pi / 2 - message.yaw)  # ENU
    assert np.abs(np.diff(np.unwrap(headings))).max() <= 0.7 * 0.02 + 1e-9
    assert headings[-1] == pytest.approx(0.0)  # the leader of experiment_4 looks east
    assert not stream.turned(state(euler=(0, 0, 0.3)))
    assert stream.turned(state(euler=(0, 0, -0.1)))


def test_a_blocked_vehicle_is_not_left_behind_by_its_target(config):
    stream = make(config)
    send(stream, Stream.HOLD, 1.0, state((0, 0, 0)), armed=False)
    for n in range(500):
        message = send(stream, Stream.CLIMB, 1.0 + 0.02 * n, state((0, 0, 0)))
    assert -message.z == pytest.approx(1.0)


def test_acceleration_feed_forward(config):
    stream = make(config, feed_forward=True)
    for n in range(100):
        values = [min(0.04 * n, 2.0), 0, 0, 0, 0, 0]  # 2 m/s^2 until 2 m/s
        message = send(stream, Stream.PLANNER, 1.0 + 0.02 * n, values=values)
        if n == 40:
            assert message.afy == pytest.approx(2.0, rel=0.02)
    assert message.type_mask == 0x0807
    assert abs(message.afy) < 0.01


def test_position_and_velocity_hold_where_velocity_alone_drifts(config):
    stream = make(config, "position_velocity")
    for n in range(100):
        message = send(stream, Stream.PLANNER, 1.0 + 0.02 * n, state((0, 0, 3)), [0.5] + [0] * 5)
    assert message.type_mask == 0x09C0
    assert message.y == pytest.approx(0.02 * 99 * 0.5, rel=0.05)
    for n in range(300):
        message = send(stream, Stream.PLANNER, 3.0 + 0.02 * n, state((0, 0, 3)), [2.0] + [0] * 5)
    assert message.y == pytest.approx(1.5, rel=0.05)  # no farther ahead than the leash
    for n in range(10):
        message = send(stream, Stream.PLANNER, 9.0 + 0.02 * n, state((-0.4, 0, 3)), [0] * 6)
    assert message.y > 0.5  # it drifted back: the reference pulls


def test_attitude_targets_on_the_wire(config):
    weight = config.controller.nominal[0] * 9.81
    message = send(make(config, "attitude"), Stream.PLANNER, values=[0, 0, weight, 0, 0, 0])
    assert message.get_type() == "SET_ATTITUDE_TARGET"
    assert message.type_mask == 0b011  # PX4: attitude, thrust and the yaw rate
    assert message.body_yaw_rate == 0.0
    assert message.thrust == pytest.approx(0.5)
    assert abs(message.q[0]) == pytest.approx(math.sqrt(0.5))  # facing east


def test_an_attitude_only_vehicle_holds_a_point_in_wind(config):
    stream = make(config, "attitude", GENERIC)
    at_rest = send(stream, Stream.HOLD, 1.0, state((0, 0, 0)), armed=False)
    assert at_rest.thrust == 0.0  # nothing turns before it is armed
    position, velocity = np.array([0.0, 0.0, 0.0]), np.zeros(3)
    dt, wind = 0.02, np.array([0.6, 0.0, 0.0])
    odometry = state()
    for n in range(1500):
        odometry[0:3], odometry[7:10] = position, 0.0
        odometry[3:7] = [0, 0, 0, 1]
        odometry[7:10] = velocity
        message = send(stream, Stream.CLIMB, 1.0 + dt * n, odometry)
        up = rotation_from_quaternion(_ours(message.q))[:, 2]
        pull = up * message.thrust / 0.5 * 9.81 + wind - np.array([0, 0, 9.81])
        velocity = velocity + dt * pull
        position = position + dt * velocity
        if position[2] < 0.0:
            position[2], velocity = 0.0, np.zeros(3)
    assert position == pytest.approx([0, 0, 3.0], abs=0.1)
    assert message.type_mask == 0


def _ours(wxyz):
    from ptnsbc_io.mavlink.frames import quaternion_ned_frd_to_enu_flu

    return quaternion_ned_frd_to_enu_flu(np.array(wxyz))
