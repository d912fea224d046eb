"""What a UAV sees near it: its own errors in both ends, and noise as wide as asked for."""

import numpy as np
import pytest

from ptnsbc_core.kinematics import quaternion_from_euler, velocity_enu
from ptnsbc_sim.disturbances.sensor_noise import SensorNoise, add_sensor_noise

NEAR = np.array([[1.0, 2.0, 3.0, 0.5, 0.125, 0.25, 0.375]])
STILL = np.zeros(6)


def vehicle(position: tuple[float, ...], velocity: tuple[float, ...]) -> np.ndarray:
    out = np.zeros(13)
    out[0:3], out[7:10] = position, velocity
    out[3:7] = quaternion_from_euler(np.array([0.2, -0.1, 1.0]))
    return out


def test_distance_and_motion_against_the_uav_stay_true() -> None:
    truth, seen = vehicle((0, 0, 0), (1, 0, 0)), vehicle((0.03, -0.02, 0.01), (1.1, -0.05, 0.02))
    moved = add_sensor_noise(NEAR, truth, seen, STILL, SensorNoise(0.0, 0.0))
    np.testing.assert_allclose(moved[0, :3] - seen[:3], NEAR[0, :3] - truth[:3], atol=1e-6)
    np.testing.assert_allclose(
        moved[0, 4:] - velocity_enu(seen), NEAR[0, 4:] - velocity_enu(truth), atol=1e-6
    )
    assert moved[0, 3] == NEAR[0, 3]
    np.testing.assert_array_equal(moved, moved.astype(np.float32))
    assert (
        add_sensor_noise(NEAR, truth, truth, STILL, SensorNoise(0.0, 0.0)).tobytes()
        == NEAR.tobytes()
    )


def test_noise_is_as_wide_as_asked_for_and_its_own_for_every_object() -> None:
    truth, near = vehicle((0, 0, 0), (0, 0, 0)), np.repeat(NEAR, 4000, axis=0)
    draws = np.random.default_rng(4).standard_normal(6 * len(near))
    off = add_sensor_noise(near, truth, truth, draws, SensorNoise(0.01, 0.03)) - near
    assert off[:, :3].std() == pytest.approx(0.01, rel=0.03)
    assert off[:, 4:].std() == pytest.approx(0.03, rel=0.03)
    assert (off[:, 3] == 0.0).all()
    assert np.corrcoef(off[:-1, 0], off[1:, 0])[0, 1] == pytest.approx(0.0, abs=0.05)
