"""Leader tracking in closed form, and on the circle."""

import numpy as np
import pytest
from on_arrays import on_arrays

from ptnsbc_core.behaviours.contract import EpochErrors
from ptnsbc_core.behaviours.leader_tracking import leader_tracking
from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import (
    PROFILE_PAPER,
    PROFILE_REFERENCE,
    PROFILE_SOFT,
    StartErrors,
    Trajectory,
)
from ptnsbc_sim.scenario import agent_config, load_scenario

leader_tracking = on_arrays(leader_tracking)
reference = on_arrays(reference)

DT, TF = 0.01, 5.0
NONE = EpochErrors(False, StartErrors(*np.zeros((4, 3))))


@pytest.mark.parametrize("profile", [PROFILE_PAPER, PROFILE_SOFT, PROFILE_REFERENCE])
def test_leader_reaches_a_place_in_closed_form(profile: int) -> None:
    config = agent_config(load_scenario("paper_5"), 1)
    loop = config.formation._replace(kappa=0.0, profile=profile, scale=1.0, residual=1e-2)
    trajectory = Trajectory((1.0, 4.0, -3.0, 8.0, 0.0, 0.0, 0.0, 0.0), np.zeros((0, 33)))
    config = config._replace(formation=loop, trajectory=trajectory)
    position, start = np.zeros(3), np.array([4.0, -3.0, 8.0])
    for k in range(round(TF / DT)):
        clock = Clock(k * DT, k * DT, DT)
        epoch = EpochErrors(k == 0, StartErrors(start, *np.zeros((3, 3))))
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
        epoch = EpochErrors(k == 0, StartErrors(start, *np.zeros((3, 3))))
        desired = reference(config.trajectory, k * DT)
        out = leader_tracking(position, desired, epoch, clock, config)
        if before is not None and profile != PROFILE_REFERENCE:
            # The reference moves by v dt + a dt^2 / 2 in a step: G / 2 a dt is what the formula leaves out.
            change = (out.velocity - before.velocity) / DT
            np.testing.assert_allclose(before.acceleration, change, atol=4e-3)
        before = out
        position = position + DT * out.velocity
    assert np.linalg.norm(before.acceleration - desired.acceleration) < 0.02
