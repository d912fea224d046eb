"""The mission: the leader on its trajectory, the attitude, and holding a position."""

import numpy as np
import pytest
from on_arrays import on_arrays

from ptnsbc_core.algebra import odometry_tuple
from ptnsbc_core.behaviours.mission import attitude, hold_velocity, leader_tracking
from ptnsbc_core.behaviours.recovery import UNDISTURBED
from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.kinematics import euler_rates, quaternion_from_euler
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import (
    PROFILE_PAPER,
    PROFILE_REFERENCE,
    PROFILE_SOFT,
    EpochErrors,
    StartErrors,
    Trajectory,
)
from ptnsbc_sim.scenario import agent_config, load_scenario

hold_velocity = on_arrays(hold_velocity)


def test_hold_is_proportional_and_limited() -> None:
    config = agent_config(load_scenario("paper_5"), 1)
    config = config._replace(hold_gain=1.0, filter=config.filter._replace(max_speed=4.0))
    place = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(hold_velocity(np.array([1.0, 1.0, 3.0]), place, config), [0, 1, 0])
    far = hold_velocity(np.array([31.0, 2.0, 43.0]), place, config)
    np.testing.assert_allclose(far, [-1.2, 0, -1.6])


leader_tracking = on_arrays(leader_tracking)
reference = on_arrays(reference)

DT, TF = 0.01, 5.0
NONE = EpochErrors(False, StartErrors(*np.zeros((4, 3))), UNDISTURBED)


@pytest.mark.parametrize("profile", [PROFILE_PAPER, PROFILE_SOFT, PROFILE_REFERENCE])
def test_leader_reaches_a_place_in_closed_form(profile: int) -> None:
    config = agent_config(load_scenario("paper_5"), 1)
    loop = config.formation._replace(kappa=0.0, profile=profile, scale=1.0, residual=1e-2)
    trajectory = Trajectory((1.0, 4.0, -3.0, 8.0, 0.0, 0.0, 0.0, 0.0), np.zeros((0, 33)))
    config = config._replace(formation=loop, trajectory=trajectory)
    position, start = np.zeros(3), np.array([4.0, -3.0, 8.0])
    for k in range(round(TF / DT)):
        clock = Clock(k * DT, k * DT, DT)
        epoch = EpochErrors(k == 0, StartErrors(start, *np.zeros((3, 3))), UNDISTURBED)
        desired = reference(trajectory, k * DT)
        position = position + DT * leader_tracking(position, desired, epoch, clock, config).velocity
    left = 0.0 if profile == PROFILE_REFERENCE else 1e-2 / 1.01
    np.testing.assert_allclose(start - position, left * start, atol=1e-9)


def test_leader_stays_on_the_circle() -> None:
    config = agent_config(load_scenario("paper_5"), 1)
    position = np.array([0.0, 1.0, 1.0])
    for k in range(round(12.0 / DT)):
        clock = Clock(k * DT, k * DT, DT)
        desired = reference(config.trajectory, k * DT)
        position = position + DT * leader_tracking(position, desired, NONE, clock, config).velocity
        if k * DT > TF:
            assert (
                np.linalg.norm(reference(config.trajectory, (k + 1) * DT).position - position)
                < 0.01
            )


@pytest.mark.parametrize("profile", [PROFILE_PAPER, PROFILE_SOFT, PROFILE_REFERENCE])
def test_acceleration_is_the_change_of_the_velocity_to_the_next_step(profile: int) -> None:
    """A vehicle that does what it is told: the filter's lead is then exact."""
    config = agent_config(load_scenario("paper_5"), 1)
    loop = config.formation._replace(profile=profile, residual=1e-2)
    config = config._replace(formation=loop)
    position, start = np.array([0.0, 1.0, 1.0]), np.array([0.0, 4.0, 7.0])
    before = None
    for k in range(round(6.0 / DT)):
        clock = Clock(k * DT, k * DT, DT)
        epoch = EpochErrors(k == 0, StartErrors(start, *np.zeros((3, 3))), UNDISTURBED)
        desired = reference(config.trajectory, k * DT)
        out = leader_tracking(position, desired, epoch, clock, config)
        if before is not None and profile != PROFILE_REFERENCE:
            # The reference moves by v dt + a dt^2 / 2 in a step: G / 2 a dt is what the formula leaves out.
            change = (out.velocity - before.velocity) / DT
            np.testing.assert_allclose(before.acceleration, change, atol=4e-3)
        before = out
        position = position + DT * out.velocity
    assert np.linalg.norm(before.acceleration - desired.acceleration) < 0.02


attitude = on_arrays(attitude)
euler_rates = on_arrays(euler_rates)


@pytest.mark.slow
def test_attitude_decays_in_closed_form() -> None:
    """beta_dot = W W^-1 Lambda G beta~: the Euler angles decay as if they were alone."""
    config = agent_config(load_scenario("paper_5", {"plant.kind": "rigid_body_6dof"}), 1)
    loop = config.attitude._replace(kappa=0.0, profile=PROFILE_PAPER, scale=1.0)
    config = config._replace(attitude=loop)
    euler, own = np.ones(3), np.zeros(13)
    for k in range(round(loop.duration_s / DT)):
        own[3:7] = quaternion_from_euler(euler)
        rates, error = attitude(odometry_tuple(own), 0.2, NONE, Clock(k * DT, k * DT, DT), config)
        np.testing.assert_allclose(error, [-euler[0], -euler[1], 0.2 - euler[2]], atol=1e-12)
        euler = euler + DT * euler_rates(euler, rates)
    left = loop.residual / (1.0 + loop.residual)
    np.testing.assert_allclose(euler, [left, left, 0.2 + 0.8 * left], rtol=1e-9)


def test_yaw_is_turned_the_short_way() -> None:
    config = agent_config(load_scenario("paper_5", {"plant.kind": "rigid_body_6dof"}), 1)
    own = np.zeros(13)
    own[3:7] = quaternion_from_euler(np.array([0.0, 0.0, 3.0]))
    _, error = attitude(odometry_tuple(own), -3.0, NONE, Clock(0.0, 0.0, DT), config)
    assert error[2] == pytest.approx(2.0 * np.pi - 6.0)
