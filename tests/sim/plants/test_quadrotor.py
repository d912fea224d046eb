"""Plant `quadrotor`: motors, drag and wind in closed form, and the same body as the 6-DOF plant."""

import numpy as np
import pytest

from ptnsbc_core.kinematics import rotation_from_quaternion, velocity_enu
from ptnsbc_core.types import PLANT_QUADROTOR, PLANT_RIGID_BODY
from ptnsbc_sim.plants.contract import PlantConfig, six
from ptnsbc_sim.plants.integrate import advance, initial_state, odometry

MASS, INERTIA, GRAVITY, LAG = 1.2, np.array([0.019, 0.025, 0.031]), 9.81, 0.02
WEIGHT = MASS * GRAVITY
RATES = np.array([1.0, -0.5, 2.0])


def plant_of(**changes) -> PlantConfig:
    none = six(np.zeros(6))
    limits = (25.0, (1.5, 1.5, 0.3), LAG, 0.0)
    inertia = tuple(INERTIA.tolist())
    return PlantConfig(
        PLANT_QUADROTOR, MASS, inertia, GRAVITY, *limits, np.zeros(3), none, none, none
    )._replace(**changes)


def state_of(euler=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0)):
    x = initial_state(np.array([1.0, 2.0, 3.0]), np.array(euler, dtype=float), plant_of())
    x[7:10], x[10:13] = velocity, rates
    return x


def thrust_of(thrust: float, torque=(0.0, 0.0, 0.0)) -> np.ndarray:
    return np.array([0.0, 0.0, thrust, *torque])


def flown(x, plant, seconds: float, wrench, dt: float = 0.01, substeps: int = 5):
    x = x.copy()
    for k in range(round(seconds / dt)):
        advance(x, wrench, k * dt, dt, substeps, plant)
    return x


def test_starts_with_its_weight_carried_and_hovers() -> None:
    plant, start = plant_of(), state_of(euler=(0.0, 0.0, 1.0))
    assert start[13] == WEIGHT
    np.testing.assert_allclose(flown(start, plant, 10.0, thrust_of(WEIGHT)), start, atol=1e-12)


def test_free_fall_without_thrust() -> None:
    plant, start = plant_of(), state_of(velocity=(1.0, 0, 2.0), rates=RATES)
    start[13] = 0.0
    end = flown(start, plant, 1.5, thrust_of(0.0))
    np.testing.assert_allclose(end[7:10], [1.0, 0, 2.0 - 1.5 * GRAVITY], atol=1e-12)
    assert end[2] == pytest.approx(3.0 + 3.0 - 0.5 * GRAVITY * 2.25)


def test_free_rotation_keeps_energy_momentum_and_a_unit_quaternion() -> None:
    plant, start = plant_of(), state_of(euler=(0.3, 0.2, 0.1), rates=RATES)
    end = flown(start, plant, 5.0, thrust_of(0.0), dt=0.001)

    def momentum(x: np.ndarray) -> np.ndarray:
        return rotation_from_quaternion(x[3:7]) @ (INERTIA * x[10:13])

    assert INERTIA @ end[10:13] ** 2 == pytest.approx(INERTIA @ RATES**2, rel=1e-11)
    np.testing.assert_allclose(momentum(end), momentum(start), atol=1e-11)
    assert np.linalg.norm(end[3:7]) == pytest.approx(1.0, abs=1e-15)


def test_motors_lag() -> None:
    plant, start = plant_of(), state_of()
    end = flown(start, plant, 0.03, thrust_of(20.0, (0.5, -0.4, 0.1)))
    reached = 1.0 - np.exp(-0.03 / LAG)
    assert end[13] == pytest.approx(WEIGHT + (20.0 - WEIGHT) * reached, rel=1e-5)
    np.testing.assert_allclose(end[14:17], np.array([0.5, -0.4, 0.1]) * reached, rtol=1e-5)


def test_motors_have_limits() -> None:
    plant = plant_of()
    end = flown(state_of(), plant, 1.0, thrust_of(99.0, (9.0, -9.0, 9.0)))
    np.testing.assert_allclose(end[13:17], [25.0, 1.5, -1.5, 0.3], rtol=1e-9)
    assert flown(state_of(), plant, 1.0, thrust_of(-5.0))[13] == pytest.approx(0.0, abs=1e-9)


def test_wind_carries_a_hovering_vehicle_along() -> None:
    """Linear drag c: v = w (1 - exp(-c t)), at last the wind's own velocity."""
    wind = np.array([3.0, -2.0, 0.5])
    plant = plant_of(drag=0.4, wind=wind)
    for seconds in (1.0, 5.0, 60.0):
        end = flown(state_of(), plant, seconds, thrust_of(WEIGHT))
        np.testing.assert_allclose(end[7:10], wind * (1.0 - np.exp(-0.4 * seconds)), atol=1e-9)


def test_terminal_velocity_of_a_fall() -> None:
    plant = plant_of(drag=0.5)
    start = state_of()
    start[13] = 0.0
    end = flown(start, plant, 40.0, thrust_of(0.0))
    np.testing.assert_allclose(end[7:10], [0, 0, -GRAVITY / 0.5], rtol=1e-7)


def test_integration_is_of_fourth_order() -> None:
    plant = plant_of(drag=0.3, amplitude=six(np.full(6, 0.5)))
    wrench = thrust_of(14.0, (0.02, -0.03, 0.01))
    start = state_of(euler=(0.2, 0.1, 0.3), rates=RATES)
    exact = flown(start, plant, 0.2, wrench, dt=0.2, substeps=4000)
    missed = [
        np.abs(flown(start, plant, 0.2, wrench, dt=0.2, substeps=n) - exact)[:13].max()
        for n in (40, 80, 160)
    ]
    np.testing.assert_allclose(np.log2(np.array(missed[:-1]) / missed[1:]), 4.0, atol=0.3)


@pytest.mark.parametrize("euler", [(0.0, 0.0, 0.0), (0.4, -0.3, 2.0), (1.0, 1.0, 1.0)])
def test_both_plants_are_the_same_body(euler) -> None:
    """Under the same wrench, with motors that have already reached it, and no drag."""
    wrench = thrust_of(13.0, (0.012, -0.009, 0.006))
    quadrotor = plant_of()
    rigid = quadrotor._replace(kind=PLANT_RIGID_BODY)
    one = state_of(euler, rates=RATES)
    one[13:17] = wrench[2:6]
    other = initial_state(one[:3].copy(), np.array(euler), rigid)
    other[9:12] = RATES
    for k in range(50):
        advance(one, wrench, k * 0.01, 0.01, 10, quadrotor)
        advance(other, wrench, k * 0.01, 0.01, 10, rigid)
    a, b = odometry(one, quadrotor), odometry(other, rigid)
    np.testing.assert_allclose(a[:3], b[:3], atol=1e-7)
    np.testing.assert_allclose(
        rotation_from_quaternion(a[3:7]), rotation_from_quaternion(b[3:7]), atol=1e-7
    )
    np.testing.assert_allclose(velocity_enu(a), velocity_enu(b), atol=1e-7)
    np.testing.assert_allclose(a[10:], b[10:], atol=1e-9)


def test_odometry_turns_the_velocity_into_the_body() -> None:
    x = state_of(euler=(0.3, -0.4, 1.0), velocity=(1.0, -2.0, 0.5), rates=RATES)
    own = odometry(x, plant_of())
    np.testing.assert_allclose(velocity_enu(own), [1.0, -2.0, 0.5], atol=1e-14)
    np.testing.assert_array_equal(own[10:13], RATES)
