"""The attitude behaviour in closed form."""

import numpy as np
import pytest
from on_arrays import on_arrays

from ptnsbc_core.behaviours.attitude import attitude
from ptnsbc_core.behaviours.contract import EpochErrors
from ptnsbc_core.kinematics import euler_rates, quaternion_from_euler
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import PROFILE_PAPER, StartErrors
from ptnsbc_sim.scenario import agent_config, load_scenario

attitude = on_arrays(attitude)
euler_rates = on_arrays(euler_rates)

DT = 0.01
NONE = EpochErrors(False, StartErrors(*np.zeros((4, 3))))


@pytest.mark.slow
def test_attitude_decays_in_closed_form() -> None:
    """beta_dot = W W^-1 Lambda G beta~: the Euler angles decay as if they were alone."""
    config = agent_config(load_scenario("paper_5", {"plant.kind": "rigid_body_6dof"}), 1)
    loop = config.attitude._replace(kappa=0.0, profile=PROFILE_PAPER, scale=1.0)
    config = config._replace(attitude=loop)
    euler, own = np.ones(3), np.zeros(13)
    for k in range(round(loop.duration_s / DT)):
        own[3:7] = quaternion_from_euler(euler)
        rates, error = attitude(own, 0.2, NONE, Clock(k * DT, k * DT, DT), config)
        np.testing.assert_allclose(error, [-euler[0], -euler[1], 0.2 - euler[2]], atol=1e-12)
        euler = euler + DT * euler_rates(euler, rates)
    left = loop.residual / (1.0 + loop.residual)
    np.testing.assert_allclose(euler, [left, left, 0.2 + 0.8 * left], rtol=1e-9)


def test_yaw_is_turned_the_short_way() -> None:
    config = agent_config(load_scenario("paper_5", {"plant.kind": "rigid_body_6dof"}), 1)
    own = np.zeros(13)
    own[3:7] = quaternion_from_euler(np.array([0.0, 0.0, 3.0]))
    _, error = attitude(own, -3.0, NONE, Clock(0.0, 0.0, DT), config)
    assert error[2] == pytest.approx(2.0 * np.pi - 6.0)
