"""The leader's desired curve: the paper's circle by hand, and velocities by finite differences."""

import numpy as np
import pytest
from on_arrays import on_arrays

from ptnsbc_core.trajectory import reference
from ptnsbc_core.types import TRAJECTORY_CIRCLE, TRAJECTORY_LINE
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.build import trajectory_vector

reference = on_arrays(reference)

LINE = np.array([TRAJECTORY_LINE, 1.0, 2, 3, 0.5, -0.25, 0.1, 0.7])
CIRCLE = np.array([TRAJECTORY_CIRCLE, 1.0, 2, 3, 4.0, 0.3, 0.6, -0.2])


@pytest.mark.parametrize("t", [0.0, 7.0, 31.4])
def test_circle_of_the_paper(t: float) -> None:
    """X_r1 = [5 sin(0.1 t), 5 cos(0.1 t), 8, 0, 0, 0]."""
    at = reference(trajectory_vector(load_scenario("paper_5")), t)
    np.testing.assert_allclose(at.position, [5 * np.sin(0.1 * t), 5 * np.cos(0.1 * t), 8])
    assert at.yaw == 0.0


def test_line_by_hand() -> None:
    at = reference(LINE, 4.0)
    np.testing.assert_allclose(at.position, [3.0, 1.0, 3.4])
    assert at.yaw == 0.7


@pytest.mark.parametrize("trajectory", [LINE, CIRCLE], ids=["line", "circle"])
def test_velocity_is_the_slope_of_the_position(trajectory: np.ndarray) -> None:
    for t in (0.0, 1.3, 20.0):
        ahead, behind = reference(trajectory, t + 1e-5), reference(trajectory, t - 1e-5)
        slope = (ahead.position - behind.position) / 2e-5
        np.testing.assert_allclose(reference(trajectory, t).velocity, slope, atol=1e-8)
