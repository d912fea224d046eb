"""Setpoints as they leave: clamps, feed-forward, holding, climbing, attitude targets on the wire."""

import math

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from ptnsbc_core.kinematics import quaternion_from_euler, rotation_from_quaternion
from ptnsbc_io.mavlink.autopilots import SetpointLimits
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_nodes.bridge.procedure.steps import Stream
from ptnsbc_nodes.bridge.setpoint.setpoint_stream import SetpointStream, StreamInput
from ptnsbc_nodes.bridge.setpoint.velocity_lead import VelocityLead
from ptnsbc_nodes.bridge.state_publisher import PublishedOdometry, SetpointReply
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.mavlink import Geofence

LIMITS = SetpointLimits(5.0, 3.0, 1.5, 5.0, 0.6)


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("experiment_4", {"mavlink.takeoff_height_m": 3.0})


def state(position=(0, 0, 3), euler=(0, 0, 0), velocity=(0, 0, 0), rates=(0, 0, 0)):
    odometry = np.zeros(13)
    odometry[0:3] = position
    odometry[3:7] = quaternion_from_euler(np.array(euler, dtype=float))
    odometry[7:10], odometry[10:13] = velocity, rates
    return odometry


def make(scenario, kind="velocity", autopilot="px4", feed_forward=False):
    changes = {
        "acceleration_feed_forward": feed_forward,
        "geofence": Geofence(),
        "hover_thrust": 0.5,
    }
    settings = scenario.mavlink.model_copy(update=changes)
    link = scenario.vehicle_link(1)._replace(autopilot=autopilot, setpoint=kind, sysid=3)
    stream = SetpointStream(link, settings, agent_config(scenario, 1))
    stream.guard.limits = LIMITS
    return stream


def send(stream, carried, now_s=1.0, odometry=None, values=None, offset=(0, 0, 0), armed=True):
    odometry = state() if odometry is None else odometry
    reply = None
    if values is not None:
        values = np.array(values, dtype=float)
        reply = SetpointReply(values, PublishedOdometry(now_s, now_s, odometry))
    offset = np.array(offset, float)
    return stream.message(StreamInput(carried, now_s, odometry, offset, reply, armed, 5.0))


def test_a_velocity_setpoint_is_north_east_down_with_a_heading(scenario):
    message = send(make(scenario), Stream.PLANNER, values=[1, 2, 0.5, 0, 0, 0])
    assert (message.target_system, message.target_component) == (3, 1)
    assert message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED
    assert message.type_mask == 0x09C7
    assert (message.vx, message.vy, message.vz) == (2.0, 1.0, -0.5)
    assert message.yaw == pytest.approx(math.pi / 2)


def test_speeds_are_clamped_and_counted(scenario):
    stream = make(scenario)
    message = send(stream, Stream.PLANNER, values=[30, 40, -9, 0, 0, 0])
    assert (message.vx, message.vy, message.vz) == pytest.approx((4.0, 3.0, 1.5))
    assert stream.guard.clamped == {"horizontal": 1, "down": 1}


def test_holding_is_a_point_in_the_vehicles_own_frame(scenario):
    stream = make(scenario)
    there = state((31, 2, 8))
    message = send(stream, Stream.HOLD, 1.0, there, offset=(30, 0, 1))
    assert message.type_mask == 0x09F8
    assert (message.x, message.y, message.z) == pytest.approx((2, 1, -7))
    drifted = send(stream, Stream.HOLD, 1.1, state((32, 2, 8)), offset=(30, 0, 1))
    assert drifted.y == pytest.approx(1)  # zero velocity would have let it go
    on_ground = send(stream, Stream.HOLD, 1.2, state((33, 2, 8)), offset=(30, 0, 1), armed=False)
    assert on_ground.y == pytest.approx(3)


def test_take_off_is_a_target_that_climbs_at_a_walking_pace(scenario):
    stream = make(scenario)
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


def test_take_off_turns_to_the_heading_with_which_the_formation_begins(scenario):
    stream = make(scenario)
    send(stream, Stream.HOLD, 1.0, state(euler=(0, 0, 3.0)), armed=False)
    assert stream.climb.heading_reached(state(euler=(0, 0, 3.0)))  # not on its way yet
    headings = []
    for n in range(300):
        message = send(stream, Stream.CLIMB, 1.0 + 0.02 * n, state(euler=(0, 0, 3.0)))
        headings.append(math.pi / 2 - message.yaw)  # ENU
    assert np.abs(np.diff(np.unwrap(headings))).max() <= 0.7 * 0.02 + 1e-9
    assert headings[-1] == pytest.approx(0.0)  # the leader of experiment_4 looks east
    assert not stream.climb.heading_reached(state(euler=(0, 0, 0.3)))
    assert stream.climb.heading_reached(state(euler=(0, 0, -0.1)))


def test_a_blocked_vehicle_is_not_left_behind_by_its_target(scenario):
    stream = make(scenario)
    send(stream, Stream.HOLD, 1.0, state((0, 0, 0)), armed=False)
    for n in range(500):
        message = send(stream, Stream.CLIMB, 1.0 + 0.02 * n, state((0, 0, 0)))
    assert -message.z == pytest.approx(1.0)


def test_acceleration_feed_forward(scenario):
    stream = make(scenario, feed_forward=True)
    for n in range(100):
        values = [min(0.04 * n, 2.0), 0, 0, 0, 0, 0]  # 2 m/s^2 until 2 m/s
        message = send(stream, Stream.PLANNER, 1.0 + 0.02 * n, values=values)
        if n == 40:
            assert message.afy == pytest.approx(2.0, rel=0.02)
    assert message.type_mask == 0x0807
    assert abs(message.afy) < 0.01


def test_a_vehicle_that_would_go_on_accelerating_gets_no_acceleration(scenario):
    """A link that fell silent for 1.8 s left an ArduCopter 13 m away, at 5 m/s: it integrates what it was sent last."""
    values = {"PSC_NE_VEL_P": 2.0, "PSC_NE_VEL_I": 1.0, "PSC_NE_VEL_D": 0.25, "PSC_NE_POS_P": 1.0}
    shaping = {"PSC_JERK_NE": 5.0, "WP_ACC": 2.5, "ATC_INPUT_TC": 0.15}  # a first order of 2 1/s
    stream = make(scenario, autopilot="ardupilot", feed_forward=True)
    stream.take_parameters({**values, **shaping})
    stream.fit_to_vehicle()
    ahead = VelocityLead(stream.response, 1.0 / scenario.mavlink.rate_hz)
    for n in range(40):
        wanted = [min(0.004 * n, 0.1), 0, 0, 0, 0, 0]  # 0.2 m/s^2 until 0.1 m/s
        message = send(stream, Stream.PLANNER, 1.0 + 0.02 * n, values=wanted)
        assert message.type_mask == 0x09C7
        level, push = ahead.setpoint(np.array(wanted[0:2]), stream.drag.value)
        assert message.vy == pytest.approx(level[0] + push[0] / 2.0, abs=1e-6)


def test_position_and_velocity_hold_where_velocity_alone_drifts(scenario):
    stream = make(scenario, "position_velocity")
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


def test_attitude_targets_on_the_wire(scenario):
    weight = agent_config(scenario, 1).controller.nominal[0] * 9.81
    message = send(make(scenario, "attitude"), Stream.PLANNER, values=[0, 0, weight, 0, 0, 0])
    assert message.get_type() == "SET_ATTITUDE_TARGET"
    assert message.type_mask == 0b011  # PX4: attitude, thrust and the yaw rate
    assert message.body_yaw_rate == 0.0
    assert message.thrust == pytest.approx(0.5)
    assert abs(message.q[0]) == pytest.approx(math.sqrt(0.5))  # facing east


def test_an_attitude_only_vehicle_holds_a_point_in_wind(scenario):
    stream = make(scenario, "attitude", "generic")
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


@pytest.mark.parametrize("autopilot", ["px4", "generic"])
def test_only_a_vehicle_that_takes_attitudes_alone_must_show_its_thrust(scenario, autopilot):
    stream, news = make(scenario, "attitude", autopilot), set()
    waits = stream.unprepared(state())
    for n in range(3000):
        send(stream, Stream.PLANNER, 0.02 * n, values=[0, 0, 11.7, 0, 0, 0])
        news.add(stream.learn(Stream.PLANNER, 0.02 * n, 0.02 * n, state()))
    assert bool(waits) == (autopilot == "generic")
    assert not stream.unprepared(state())
    assert any("did not show" in line for line in news) == (autopilot == "generic")
    assert stream.fit.unfit == ""


def _ours(wxyz):
    from ptnsbc_io.mavlink.frames import quaternion_ned_frd_to_enu_flu

    return quaternion_ned_frd_to_enu_flu(np.array(wxyz))
