"""The formation law: at the deadline in place, where (30) as printed is not, and at a singularity."""

import numpy as np
import pytest
from on_arrays import on_arrays

from ptnsbc_core.behaviours.contract import EpochErrors, Neighbour
from ptnsbc_core.behaviours.formation import formation
from ptnsbc_core.behaviours.leader_tracking import leader_tracking
from ptnsbc_core.nullspace import damped_solve
from ptnsbc_core.tasks.registry import evaluate, task_error
from ptnsbc_core.timebase import Clock, loop_gain
from ptnsbc_core.trajectory import reference
from ptnsbc_core.types import PROFILE_PAPER, TASKS
from ptnsbc_sim.scenario import agent_config, load_scenario

damped_solve = on_arrays(damped_solve)
evaluate = on_arrays(evaluate)
formation = on_arrays(formation)
leader_tracking = on_arrays(leader_tracking)
reference = on_arrays(reference)
task_error = on_arrays(task_error)

DT, TF = 0.01, 5.0
FOLLOWERS = (2, 3, 4, 5)
NONE = EpochErrors(False, np.zeros(3), np.zeros(3))


def by_the_design(position, parent, leader, clock, config):
    return formation(position, parent, leader, NONE, clock, config).velocity


def without_neighbours(sign: float):
    """(30): J^+ Lambda G e, and the leader's velocity with a sign; the neighbours' are not in it."""

    def law(position, parent, leader, clock, config):
        geometry = evaluate(config.task, position, parent.position, leader.position + config.anchor)
        rate = loop_gain(config.formation, clock) * task_error(geometry, config.desired)
        scale = np.array(config.row_scale)
        jacobian = geometry.own * scale.reshape(3, 1)
        scaled = scale * rate
        solved = damped_solve(
            jacobian, scaled, np.zeros(3), config.damping_threshold, config.damping_max
        )
        return sign * leader.velocity + solved.velocity

    return law


def chain(task: str, law, seconds: float = TF, profile: int = PROFILE_PAPER, kappa: float = 0.0):
    """Formation errors [m] of four single integrators behind the leader of Table 2, time base only."""
    scenario = load_scenario("paper_5", {"formation.task": task})
    configs = {uav: agent_config(scenario, uav) for uav in scenario.uav_ids}
    for uav, config in configs.items():
        loop = config.formation._replace(kappa=kappa, profile=profile, scale=1.0, residual=1e-2)
        configs[uav] = config._replace(formation=loop)
    place = {uav: scenario.uav(uav).position.copy() for uav in scenario.uav_ids}
    speed = {}
    for k in range(round(seconds / DT)):
        clock = Clock(k * DT, k * DT, DT)
        desired = reference(configs[1].trajectory, k * DT)
        speed[1] = leader_tracking(place[1], desired, NONE, clock, configs[1]).velocity
        leader = Neighbour(place[1], speed[1])
        for uav in FOLLOWERS:
            parent = Neighbour(place[uav - 1], speed[uav - 1])
            speed[uav] = law(place[uav], parent, leader, clock, configs[uav])
        for uav in place:
            place[uav] = place[uav] + DT * speed[uav]
    return np.array(
        [np.linalg.norm(place[uav] - place[1] - scenario.offset(uav)) for uav in FOLLOWERS]
    )


@pytest.mark.parametrize("task", TASKS)
def test_formation_is_there_at_the_deadline(task: str) -> None:
    assert chain(task, by_the_design).max() < 0.01


def test_printed_sign_of_30_is_metres_off() -> None:
    errors = chain("distance_angles", without_neighbours(-1.0))
    assert errors.min() > 2.0
    assert errors.max() > 5.0
    # nor does the printed "+ 1" in its gain help
    assert chain("distance_angles", without_neighbours(-1.0), kappa=1.0).max() > 2.0


def test_without_the_neighbours_velocities_it_is_decimetres_off() -> None:
    errors = chain("distance_angles", without_neighbours(1.0))
    assert 0.1 < errors.max() < 1.0
    assert errors.max() > 20.0 * chain("distance_angles", by_the_design).max()


def test_fallback_steers_where_the_task_cannot() -> None:
    """(23) is singular at a right angle at k; the law still closes on the desired offset."""
    config = agent_config(load_scenario("paper_5"), 4)
    parent = Neighbour(np.array([-1.0, -1.0, 0.0]), np.zeros(3))
    leader = Neighbour(np.zeros(3), np.zeros(3))
    position = np.array([1.0, -1.0, 0.0])
    clock = Clock(10.0, 10.0, DT)
    first = formation(position, parent, leader, NONE, clock, config)
    assert first.singular_value < 1e-6
    for _ in range(1500):
        out = formation(position, parent, leader, NONE, clock, config)
        position = position + DT * out.velocity
    desired = evaluate(config.task, position, parent.position, leader.position)
    assert np.linalg.norm(task_error(desired, config.desired)) < 0.02


def test_leaders_velocity_stays_outside_the_damping() -> None:
    """At a singular configuration without error, the UAV moves exactly as the leader does."""
    config = agent_config(load_scenario("paper_5"), 4)
    moving = np.array([0.5, -0.2, 0.1])
    parent, leader = Neighbour(np.array([-1.0, -1.0, 0]), moving), Neighbour(np.zeros(3), moving)
    position = np.array([1.0, -1.0, 0.0])
    here = evaluate(config.task, position, parent.position, leader.position).value
    config = config._replace(desired=tuple(here), offset=tuple(position - parent.position))
    out = formation(position, parent, leader, NONE, Clock(1.0, 1.0, DT), config)
    assert out.singular_value < 1e-6
    np.testing.assert_allclose(out.velocity, moving, atol=1e-12)
