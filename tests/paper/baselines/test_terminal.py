"""The sliding mode on a double integrator and on the paper's plant."""

import numpy as np
import pytest

from paper.baselines.reaching import EXPONENTIAL, TWO_SIDED, Reaching
from paper.baselines.terminal import Axis, demanded, torque_for, turning_forward
from ptnsbc_core.kinematics import body_rates, euler_rates
from ptnsbc_core.types import PLANT_RIGID_BODY
from ptnsbc_sim.plants.contract import PlantConfig, six
from ptnsbc_sim.plants.integrate import advance, initial_state, odometry

DT = 1e-3
INERTIA = np.array([0.019, 0.019, 0.021])


def axis(kind: int, power: float, deadline_s: float, robust: float = 0.6) -> Axis:
    half = Reaching(kind, 0.5 * deadline_s, power)
    return Axis(half, half, robust, 0.05)


both = pytest.mark.parametrize(("kind", "power"), [(EXPONENTIAL, 0.3), (TWO_SIDED, 0.4)])


@both
@pytest.mark.parametrize("start", [0.5, 8.0, 50.0])
def test_a_double_integrator_is_at_rest_in_its_place_before_the_deadline(
    kind, power, start
) -> None:
    """With a disturbance below k, and whatever the start is."""
    law = axis(kind, power, 5.0)
    error, rate = np.array([start, -start, 0.0]), np.array([0.0, 0.3, -1.0])
    for tick in range(round(4.9 / DT)):
        push = 0.4 * np.array([np.sin(tick * DT), np.cos(tick * DT), 0.5])
        rate += DT * (demanded(error, rate, np.zeros(3), law) + push)
        error += DT * rate
    assert np.abs(error).max() < 0.01
    assert np.abs(rate).max() < 0.05


def test_the_reference_is_fed_forward() -> None:
    law = axis(EXPONENTIAL, 0.3, 5.0)
    at_rest = np.zeros(3)
    forward = np.array([0.1, -0.2, 0.3])
    np.testing.assert_allclose(demanded(at_rest, at_rest, forward, law), forward)


def test_turning_forward_by_differences() -> None:
    """d/dt (W^-1) euler_dot along a straight line of Euler angles."""
    euler, turning, step = np.array([0.4, -0.7, 1.2]), np.array([0.9, -1.1, 0.6]), 1e-6
    after = np.array(body_rates(euler + step * turning, turning))
    before = np.array(body_rates(euler - step * turning, turning))
    np.testing.assert_allclose(
        turning_forward(euler, turning), (after - before) / (2 * step), atol=1e-8
    )
    np.testing.assert_allclose(euler_rates(euler, body_rates(euler, turning)), turning)


@both
def test_a_body_that_starts_at_one_radian_is_level_before_its_deadline(kind, power) -> None:
    still = six(np.zeros(6))
    plant = PlantConfig(
        PLANT_RIGID_BODY, 1.2, tuple(INERTIA.tolist()), 9.81, np.inf, (np.inf, np.inf, np.inf), 0.0, 0.0,
        np.zeros(3), still, still, still,
    )  # fmt: skip
    state = initial_state(np.zeros(3), np.ones(3), plant)
    law = Axis(*axis(kind, power, 1.5)[:2], 0.4, 0.1)
    for tick in range(150):
        wrench = np.zeros(6)
        wrench[3:6] = torque_for(odometry(state, plant), 0.3, law, INERTIA)
        advance(state, wrench, tick * 0.01, 0.01, 5, plant)
    np.testing.assert_allclose(state[3:6], [0.0, 0.0, 0.3], atol=0.01)
    assert np.abs(state[9:12]).max() < 0.05
