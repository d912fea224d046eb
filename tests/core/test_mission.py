"""The mission: holding a position."""

import numpy as np
from on_arrays import on_arrays

from ptnsbc_core.mission import hold_velocity
from ptnsbc_sim.scenario import agent_config, load_scenario

hold_velocity = on_arrays(hold_velocity)


def test_hold_is_proportional_and_limited() -> None:
    config = agent_config(load_scenario("paper_5"), 1)
    config = config._replace(hold_gain=1.0, filter=config.filter._replace(max_speed=4.0))
    place = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(hold_velocity(np.array([1.0, 1.0, 3.0]), place, config), [0, 1, 0])
    far = hold_velocity(np.array([31.0, 2.0, 43.0]), place, config)
    np.testing.assert_allclose(far, [-1.2, 0, -1.6])
