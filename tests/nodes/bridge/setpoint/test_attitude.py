"""Attitude targets: quaternion from a wrench, tilt limit, hover thrust, and the target's own body rates."""

import math
from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pymavlink")

from ptnsbc_core.control.adaptation import initial_observer
from ptnsbc_core.control.quadrotor_control import (
    attitude_error,
    desired_rotation,
    quadrotor_control,
)
from ptnsbc_core.control.rigid_body_control import VelocityReference
from ptnsbc_core.kinematics import quaternion_from_euler, rotation_from_quaternion, velocity_enu
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import AdaptationState
from ptnsbc_nodes.bridge.setpoint.attitude import (
    AttitudeResponse,
    BodyRateEstimator,
    attitude_from_wrench,
    largest_force_kappa_1_s,
    limit_tilt,
    unsaturated_axes,
    vertical_rate,
)
from ptnsbc_sim.scenario import agent_config, load_scenario


@pytest.fixture(scope="module")
def config():
    return agent_config(load_scenario("experiment_4"), 1)


@pytest.fixture(scope="module")
def flown():
    return agent_config(load_scenario("experiment_4").bridged(), 1)


def state(euler=(0, 0, 0), rates=(0, 0, 0), velocity=(0, 0, 0)):
    odometry = np.zeros(13)
    odometry[3:7] = quaternion_from_euler(np.array(euler, dtype=float))
    odometry[7:10], odometry[10:13] = velocity, rates
    return odometry


@pytest.mark.parametrize("euler", [(0, 0, 0), (0.1, -0.2, 0.5), (-0.2, 0.1, 3.0)])
@pytest.mark.parametrize("push", [(0, 0, 0), (0.3, -0.2, 0.1)])
def test_the_wrench_is_read_back_to_the_attitude_that_the_controller_meant(config, euler, push):
    odometry, still = state(euler, (0.1, -0.1, 0.05)), (0.0, 0.0, 0.0)
    yaw = euler[2] + 0.05
    command = VelocityReference(tuple(map(float, push)), still, still, still, yaw)
    controller = config.controller
    before = AdaptationState(
        controller.nominal, (0.0, 0.0), initial_observer(velocity_enu(odometry))
    )
    clock = Clock(5.0, 5.0, 0.01)
    control = quadrotor_control(
        odometry, command, before, clock, controller, config.filter.max_rate
    )
    wrench = np.array([*control.force, *control.torque])
    wanted = attitude_from_wrench(wrench, odometry, 5.0, controller, 0.7)
    gain = controller.force.scale * controller.force.kappa
    force = gain * np.array(push) + np.array([0, 0, 9.81])
    meant = attitude_error(rotation_from_quaternion(odometry[3:7]), desired_rotation(force, yaw))
    read = attitude_error(rotation_from_quaternion(odometry[3:7]), rotation_from_quaternion(wanted))
    if not np.abs(wrench[3:6] / controller.max_torque).max() > 0.99:
        assert read == pytest.approx(meant, abs=0.03)
    assert np.dot(read, meant) >= 0.0


def test_a_torque_at_its_limit_does_not_tell_what_was_meant(config):
    controller = config.controller
    wrench = np.array([0, 0, 12.0, 0.1, -1.5, 0.3])
    assert controller.max_torque == (1.5, 1.5, 0.3)
    assert unsaturated_axes(wrench, controller).tolist() == [True, False, False]


def test_tilt_is_limited_in_the_direction_it_has():
    steep = quaternion_from_euler(np.array([0.0, 1.2, 0.4]))
    limited = limit_tilt(steep, 0.6)
    before, after = (rotation_from_quaternion(q)[:, 2] for q in (steep, limited))
    assert math.acos(after[2]) == pytest.approx(0.6)
    assert math.atan2(after[1], after[0]) == pytest.approx(math.atan2(before[1], before[0]))
    gentle = quaternion_from_euler(np.array([0.1, 0.2, 0.4]))
    assert limit_tilt(gentle, 0.6).tolist() == gentle.tolist()


ALL = np.ones(3, dtype=bool)
DT = 0.02
SETTLED = 100  # targets: two seconds


def quaternion(roll=0.0, pitch=0.0, yaw=0.0):
    return quaternion_from_euler(np.array([roll, pitch, yaw]))


def after(targets, known=ALL):
    """Rates with the last of some targets, one every DT."""
    estimator = BodyRateEstimator()
    for n, target in enumerate(targets):
        rates = estimator.update(target, known, DT * n)
    return rates


def test_a_heading_that_turns_left():
    rates = after([quaternion(yaw=0.5 * DT * n) for n in range(SETTLED)])
    assert rates == pytest.approx([0, 0, 0.5], abs=1e-4)


def test_rates_are_those_of_the_targets_body():
    # Nose up by 30 degrees, the heading turns left by 1 rad/s: in the body that is half a radian of roll.
    # FLU: nose up is a negative pitch, and z of the world is (-sin pitch, 0, cos pitch) = (0.5, 0, 0.866).
    rates = after([quaternion(0.0, -math.pi / 6, DT * n) for n in range(SETTLED)])
    assert rates == pytest.approx([0.5, 0.0, math.sqrt(0.75)], abs=1e-3)


def test_a_new_target_is_no_motion_of_the_old_one():
    turned = quaternion(yaw=1.0)
    assert after([quaternion()] * 50 + [turned] * 50).tolist() == [0, 0, 0]


def test_a_target_that_is_sent_again_does_not_stop():
    estimator = BodyRateEstimator()
    for n in range(SETTLED):
        for _ in range(2):  # the stream is quicker than the controller
            rates = estimator.update(quaternion(yaw=0.5 * DT * n), ALL, DT * n)
    assert rates[2] == pytest.approx(0.5, abs=1e-4)


def test_about_an_axis_at_its_torque_limit_there_is_no_rate():
    targets = [quaternion(yaw=0.5 * DT * n) for n in range(SETTLED)]
    known = np.array([True, True, False])
    assert after(targets, known).tolist() == [0, 0, 0]


def test_after_a_gap_it_begins_anew():
    estimator = BodyRateEstimator()
    for n in range(SETTLED):
        estimator.update(quaternion(yaw=0.5 * DT * n), ALL, DT * n)
    assert estimator.update(quaternion(yaw=1.1), ALL, DT * SETTLED + 1.0).tolist() == [0, 0, 0]


def test_a_vehicle_that_lags_is_not_chased_round():
    """The heading of a target that is at most 0.15 rad ahead, as after a torque at its limit.

    A vehicle that adds the rates to its own would turn for ever if they were the vehicle's.
    """
    estimator, yaw, goal, fastest = BodyRateEstimator(), 0.0, 1.5, 0.0
    for n in range(500):
        ahead = min(goal - yaw, 0.15)
        known = np.array([True, True, goal - yaw < 0.15])
        rates = estimator.update(quaternion(yaw=yaw + ahead), known, DT * n)
        rate = 4.0 * ahead + rates[2]
        fastest = max(fastest, rate)
        yaw += DT * rate
    assert yaw == pytest.approx(goal, abs=0.01)
    assert fastest <= 4.0 * 0.15 + 1e-9


angles = st.floats(-0.6, 0.6)


@given(angles, angles, st.floats(-3, 3), st.floats(-2, 2))
def test_the_part_about_the_vertical_is_that_of_the_heading(roll, pitch, yaw, turn):
    attitude = quaternion(roll, pitch, yaw)
    rates = turn * rotation_from_quaternion(attitude)[2]
    assert vertical_rate(rates, attitude) == pytest.approx(turn, abs=1e-9)


def most(config, delay_s, tilt_lag_s=0.165):
    return largest_force_kappa_1_s(config, AttitudeResponse(delay_s, tilt_lag_s))


def step_response(config, kappa_1_s, delay_s, tilt_lag_s):
    """Places (N,) [m] after a wanted step of 1 m, and none of the formulas: a tilt behind a late target, in time."""
    dt, bound = 1e-3, config.controller.bound_cap[0] / config.controller.boundary[0]
    planner, bandwidth = config.formation.kappa, config.filter.bandwidth
    late = deque([(0.0, 0.0)] * max(round(delay_s / dt), 1))
    place = speed = tilt = rate = wanted = before = slope = 0.0
    out = []
    for _ in range(20000):
        push = bandwidth * (planner * (1.0 - place) - wanted)
        wanted += dt * push
        target = push - (kappa_1_s + bound) * (speed - wanted)
        slope += dt * ((target - before) / dt - slope) / BodyRateEstimator.SMOOTHING_S
        before = target
        late.append((target, slope))
        asked, ahead = late.popleft()
        rate += dt * ((asked - tilt) / (tilt_lag_s - 0.04) + ahead - rate) / 0.04
        tilt += dt * rate
        speed += dt * tilt
        place += dt * speed
        out.append(place)
    return np.array(out)


@pytest.mark.parametrize("delay_s", [0.03, 0.06, 0.1])
@pytest.mark.parametrize("tilt_lag_s", [0.1, 0.165, 0.25])
def test_the_largest_gain_settles_and_twice_as_much_swings(flown, delay_s, tilt_lag_s):
    found = most(flown, delay_s, tilt_lag_s)
    if found > 0.5:
        settled = step_response(flown, found, delay_s, tilt_lag_s)
        assert settled.max() < 1.2
        assert settled[15000:] == pytest.approx(1.0, abs=0.02)
    wild = step_response(flown, 2.0 * found + 2.0, delay_s, tilt_lag_s)
    assert np.abs(wild[15000:] - 1.0).max() > 0.05


def test_a_vehicle_that_flies_no_rates_of_the_target_bears_more_delay_and_less_lag(flown):
    """The rates that are sent make up for the lag of the tilt, and turn a late target too far."""

    def both(delay_s, tilt_lag_s):
        return [
            largest_force_kappa_1_s(flown, AttitudeResponse(delay_s, tilt_lag_s, led=led))
            for led in (True, False)
        ]

    led, bare = both(0.05, 0.12)
    assert bare > led
    led, bare = both(0.05, 0.35)
    assert bare < led


def test_the_largest_gain_falls_with_the_delay_and_the_lag(flown):
    delays = [most(flown, 0.01 * n) for n in range(20)]
    lags = [most(flown, 0.05, 0.02 * n) for n in range(4, 20)]
    assert delays == sorted(delays, reverse=True)
    assert lags == sorted(lags, reverse=True)
    assert delays[-1] == 0.0
