"""Plant `rigid_body_6dof`: free motion in closed form, conservation, and the order of the integration."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ptnsbc_core.kinematics import rotation_from_quaternion, velocity_enu
from ptnsbc_core.types import PLANT_RIGID_BODY
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.plants.contract import PlantConfig, disturbance, no_waves, six, update_waves
from ptnsbc_sim.plants.integrate import advance, initial_state, odometry
from ptnsbc_sim.scenario import agent_config, load_scenario

MASS, INERTIA, GRAVITY = 1.2, np.array([0.019, 0.025, 0.031]), 9.81
NO_WRENCH = np.zeros(6)
RATES = np.array([1.0, -0.5, 2.0])


def plant_of(gravity: float = GRAVITY, **changes) -> PlantConfig:
    none = six(np.zeros(6))
    unlimited = (np.inf, (np.inf, np.inf, np.inf), 0.0, 0.0)
    inertia = tuple(INERTIA.tolist())
    return PlantConfig(
        PLANT_RIGID_BODY, MASS, inertia, gravity, *unlimited, np.zeros(3), none, none, none
    )._replace(**changes)


def state_of(euler=(0.3, -0.4, 1.0), velocity=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0)):
    x = initial_state(np.array([1.0, 2.0, 3.0]), np.array(euler), plant_of())
    x[6:9], x[9:12] = velocity, rates
    return x


def flown(x, plant, seconds: float, dt: float = 0.01, substeps: int = 5, wrench=NO_WRENCH):
    x = x.copy()
    for k in range(round(seconds / dt)):
        advance(x, wrench, k * dt, dt, substeps, plant)
    return x


def momentum(x, plant) -> np.ndarray:
    """Angular momentum in the world frame."""
    own = odometry(x, plant)
    return rotation_from_quaternion(own[3:7]) @ (INERTIA * own[10:13])


def test_free_fall_in_closed_form_whatever_the_tumbling() -> None:
    plant = plant_of()
    start = state_of(velocity=(2.0, -1.0, 3.0), rates=RATES)
    v0 = np.array(velocity_enu(odometry(start, plant)))
    end = odometry(flown(start, plant, 0.7, dt=0.001), plant)
    down = np.array([0.0, 0.0, -GRAVITY])
    np.testing.assert_allclose(velocity_enu(end), v0 + 0.7 * down, atol=1e-8)
    np.testing.assert_allclose(end[:3], [1, 2, 3] + 0.7 * v0 + 0.5 * 0.49 * down, atol=1e-8)


def test_free_rotation_keeps_energy_and_momentum() -> None:
    plant = plant_of(gravity=0.0)
    start = state_of(rates=RATES)
    end = flown(start, plant, 0.7, dt=0.001)
    assert INERTIA @ end[9:12] ** 2 == pytest.approx(INERTIA @ RATES**2, rel=1e-12)
    np.testing.assert_allclose(momentum(end, plant), momentum(start, plant), atol=1e-11)
    assert np.linalg.norm(INERTIA * end[9:12]) == pytest.approx(np.linalg.norm(INERTIA * RATES))
    assert np.linalg.norm(end[9:12] - RATES) > 0.1  # it did tumble


def test_total_energy_is_kept_in_free_fall() -> None:
    plant = plant_of()
    start = state_of(velocity=(2.0, -1.0, 3.0), rates=RATES)

    def energy(x: np.ndarray) -> float:
        turning = 0.5 * INERTIA @ x[9:12] ** 2
        return 0.5 * MASS * x[6:9] @ x[6:9] + turning + MASS * GRAVITY * x[2]

    assert energy(flown(start, plant, 0.7, dt=0.001)) == pytest.approx(energy(start), rel=1e-10)


def test_integration_is_of_fourth_order() -> None:
    plant = plant_of(amplitude=six(np.full(6, 0.5)))
    wrench = np.array([1.0, -2.0, 12.0, 0.01, 0.02, -0.01])
    start = state_of(rates=RATES)
    exact = flown(start, plant, 0.4, dt=0.4, substeps=2000, wrench=wrench)
    missed = [
        np.abs(flown(start, plant, 0.4, dt=0.4, substeps=n, wrench=wrench) - exact).max()
        for n in (10, 20, 40)
    ]
    orders = np.log2(np.array(missed[:-1]) / missed[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.25)


def test_weight_carried_in_the_body_frame_is_hovering() -> None:
    plant, start = plant_of(), state_of()
    up = rotation_from_quaternion(odometry(start, plant)[3:7])[2]
    wrench = np.concatenate([MASS * GRAVITY * up, np.zeros(3)])
    np.testing.assert_allclose(flown(start, plant, 5.0, wrench=wrench), start, atol=1e-12)


def test_a_force_accelerates_along_its_world_direction() -> None:
    plant, start = plant_of(gravity=0.0), state_of()
    wrench = np.array([0.6, 0, 0, 0, 0, 0])
    r = rotation_from_quaternion(odometry(start, plant)[3:7])
    end = odometry(flown(start, plant, 2.0, wrench=wrench), plant)
    np.testing.assert_allclose(velocity_enu(end), r[:, 0] * 0.6 / MASS * 2.0, atol=1e-12)


def test_wind_carries_a_tumbling_body_along() -> None:
    """Drag is linear in the air speed, so attitude and tumbling do not matter."""
    wind = np.array([3.0, -2.0, 0.5])
    plant = plant_of(gravity=0.0, drag=0.4, wind=wind)
    start = state_of(velocity=(0.0, 0.0, 0.0), rates=RATES)
    for seconds in (0.3, 0.7):
        velocity = velocity_enu(odometry(flown(start, plant, seconds, dt=0.001), plant))
        expected = wind * (1.0 - np.exp(-0.4 * seconds))
        np.testing.assert_allclose(velocity, expected, atol=1e-9)


def test_true_mass_and_inertia_are_the_plants_and_nominal_ones_the_laws() -> None:
    changes = {"uavs[2].mass_scale": 1.3, "uavs[2].inertia_scale": [0.7, 1.0, 1.2]}
    usual, changed = load_scenario("paper_5"), load_scenario("paper_5", changes)
    plant = plant_config(changed, 3)
    assert plant.mass == pytest.approx(1.3 * 1.2)
    np.testing.assert_allclose(plant.inertia, [0.7 * 0.019, 0.019, 1.2 * 0.021])
    np.testing.assert_equal(tuple(agent_config(changed, 3)), tuple(agent_config(usual, 3)))
    assert plant_config(changed, 2).mass == plant_config(usual, 2).mass == 1.2


def test_steady_turn_about_one_axis() -> None:
    plant = plant_of(gravity=0.0)
    start = state_of(euler=(0.0, 0.0, 0.2))
    end = flown(start, plant, 1.0, wrench=np.array([0.0, 0, 0, 0, 0, 0.031]))
    assert end[11] == pytest.approx(1.0)
    assert end[5] == pytest.approx(0.2 + 0.5)


def test_disturbance_is_an_acceleration() -> None:
    amplitude = six([0.2, 0.1, 0.0, 0.0, 0.0, 0.3])
    phase = six([np.pi / 2, 0, 0, 0, 0, 0])
    offset = six([0.0, 0, 0.05, 0, 0, 0])
    plant = plant_of(gravity=0.0, amplitude=amplitude, phase=phase, offset=offset)
    t = 0.7
    waves = no_waves(1)
    update_waves(waves, plant, t, 0.01)
    push = disturbance(plant, waves.sines, 0)
    np.testing.assert_allclose(
        push, [0.2 * np.cos(t), 0.1 * np.sin(t), 0.05, 0, 0, 0.3 * np.sin(t)]
    )
    still = plant._replace(amplitude=six([*amplitude[:5], 0.0]))
    end = flown(state_of(euler=(0.0, 0.0, 0.0)), still, 3.0)
    expected = [0.2 * np.sin(3.0), 0.1 * (1.0 - np.cos(3.0)), 0.15]
    np.testing.assert_allclose(end[6:9], expected, atol=1e-10)


def test_odometry_agrees_with_scipy() -> None:
    x = state_of(euler=(0.3, -1.2, 2.0), velocity=(1.0, 2, 3), rates=RATES)
    own = odometry(x, plant_of())
    expected = Rotation.from_euler("ZYX", [2.0, -1.2, 0.3])
    np.testing.assert_allclose(Rotation.from_quat(own[3:7]).as_matrix(), expected.as_matrix())
    np.testing.assert_array_equal(own[[0, 1, 2, 7, 8, 9, 10, 11, 12]], [1, 2, 3, 1, 2, 3, *RATES])
