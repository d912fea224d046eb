"""Attitude targets: read from a wrench, limited in tilt, with the thrust that carries the vehicle."""

import math

import numpy as np
import pytest

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
from ptnsbc_nodes.bridge.setpoint import attitude
from ptnsbc_nodes.bridge.setpoint.hover_thrust import HoverThrust
from ptnsbc_sim.scenario import agent_config, load_scenario


@pytest.fixture(scope="module")
def config():
    return agent_config(load_scenario("experiment_4"), 1)


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
    wanted = attitude.from_wrench(wrench, odometry, 5.0, controller, 0.7)
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
    assert attitude.understood(wrench, controller).tolist() == [True, False, False]


def test_tilt_is_limited_in_the_direction_it_has():
    steep = quaternion_from_euler(np.array([0.0, 1.2, 0.4]))
    limited = attitude.tilt_limited(steep, 0.6)
    before, after = (rotation_from_quaternion(q)[:, 2] for q in (steep, limited))
    assert math.acos(after[2]) == pytest.approx(0.6)
    assert math.atan2(after[1], after[0]) == pytest.approx(math.atan2(before[1], before[0]))
    gentle = quaternion_from_euler(np.array([0.1, 0.2, 0.4]))
    assert attitude.tilt_limited(gentle, 0.6).tolist() == gentle.tolist()


def test_hover_thrust_is_learnt_from_what_thrust_does():
    hover = HoverThrust(0.5, 9.81)
    climb, now = 0.0, 0.0
    for _ in range(1000):  # it really hovers at 0.4
        thrust = hover.normalised(1.2 * 9.81 - 0.6 * climb, 1.2)
        hover.sent(thrust)
        climb += 0.02 * 9.81 * (thrust / 0.4 - 1.0)
        now += 0.02
        hover.flown(now, state(velocity=(0, 0, climb)))
    assert hover.value == pytest.approx(0.4, rel=0.03)
