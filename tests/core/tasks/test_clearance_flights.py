"""Clearance in flight: out of a keep-out, past what moves, without chatter, and out of dead ends."""

import numpy as np
import pytest
from clearance_case import (
    DT,
    FREE,
    KEEP_OUT,
    NO_DRIFT,
    NOTHING_TOLD,
    ROCK,
    braking,
    clearance,
    compose_with_clearance,
    config_of,
    object_at,
    result,
)
from on_arrays import on_arrays

from ptnsbc_core.algebra import limit_norm
from ptnsbc_core.behaviours.recovery import standing_time, stands_still, way_out
from ptnsbc_core.tasks.near_constraints import SIDE, USED, ObstacleView, empty_memory
from ptnsbc_core.types import AVOIDANCE_SET_BASED, AVOIDANCE_SWITCHED, FormationPlace

limit_norm = on_arrays(limit_norm)
stands_still, way_out = on_arrays(stands_still), on_arrays(way_out)


def fly(config, wanted_at, start, near, seconds: float, noise: float = 0.0):
    """Single integrator: positions, velocities, number of binding rows, last memory."""
    rng = np.random.default_rng(0)
    position, memory = np.array(start, dtype=float), empty_memory()
    positions, velocities, rows = [], [], []
    for k in range(round(seconds / DT)):
        seen = position + noise * rng.normal(size=3)
        top, velocity = result(seen, wanted_at(position), near(k * DT), config, memory)
        memory = top.memory
        position = position + DT * velocity
        positions.append(position)
        velocities.append(velocity)
        rows.append(top.jacobian.shape[0])
    return np.array(positions), np.array(velocities), np.array(rows), memory


def standing(*rows):
    table = np.stack(rows)
    return lambda _: table


def eastwards(_: np.ndarray) -> np.ndarray:
    return np.array([1.0, 0.0, 0.0])


def test_inside_pushes_out() -> None:
    positions, _, _, _ = fly(
        config_of(), lambda _: np.zeros(3), (0.3, 0.4, 0), standing(*ROCK), 3.0
    )
    distance = np.linalg.norm(positions, axis=1)
    assert np.all(np.diff(distance) >= 0.0)
    assert distance[100] > KEEP_OUT - 0.02  # the encounter's time base: 1 m to its residual in 1 s
    assert distance[-1] == pytest.approx(KEEP_OUT, abs=1e-3)


def test_a_moving_object_is_given_way_to() -> None:
    def passing(t: float) -> np.ndarray:
        return object_at((-6.0 + t, 0.2, 0.0), (1.0, 0, 0))[np.newaxis]

    positions, _, _, _ = fly(config_of(), lambda p: -p, (0.0, 0, 0), passing, 12.0)
    centres = np.stack([passing((k + 1) * DT)[0, 0:3] for k in range(len(positions))])
    assert np.linalg.norm(positions - centres, axis=1).min() >= KEEP_OUT - 1e-3
    assert np.linalg.norm(positions[-1]) < 0.05


@pytest.mark.parametrize("approach", [config_of, braking])
@pytest.mark.parametrize(("above", "least"), [(0.0, 0.5), (1.5, 1.5)])
def test_the_keep_out_above_another_one_is_its_own(approach, above: float, least: float) -> None:
    """One that wants to come down on another one stops above it, and one that comes from beside nearer to it."""
    near = standing(object_at((0.0, 0, 0), (0, 0, 0), 0.5, above))
    for start, kept in (((0.0, 0.0, 3.0), least), ((3.0, 0.0, 0.0), 0.5)):
        positions, _, _, _ = fly(approach(), lambda p: limit_norm(-p, 1.0), start, near, 10.0)
        assert np.linalg.norm(positions[-1]) == pytest.approx(kept, abs=0.03)
        assert np.linalg.norm(positions * (1, 1, 0.5 / least), axis=1).min() > 0.5 - 1e-6


@pytest.mark.parametrize(("noise", "ratio"), [(0.0, 3.0), (0.01, 3.0), (0.02, 3.0)])
def test_switched_chatters_where_set_based_glides(noise: float, ratio: float) -> None:
    """A pass 0.6 m off the centre: total variation of the velocity, and changes of the task stack."""
    moved, changes, least = {}, {}, {}
    for rule in (AVOIDANCE_SET_BASED, AVOIDANCE_SWITCHED):
        start = (-4.0, 0.6, 0.0)
        positions, velocities, rows, _ = fly(
            config_of(rule), eastwards, start, standing(*ROCK), 10.0, noise
        )
        moved[rule] = np.abs(np.diff(velocities, axis=0)).sum()
        changes[rule] = np.count_nonzero(np.diff(rows))
        least[rule] = np.linalg.norm(positions, axis=1).min()
        assert positions[-1][0] > 4.0
    assert moved[AVOIDANCE_SWITCHED] > ratio * moved[AVOIDANCE_SET_BASED]
    assert changes[AVOIDANCE_SWITCHED] >= 5 * changes[AVOIDANCE_SET_BASED]
    assert changes[AVOIDANCE_SET_BASED] <= 6
    assert least[AVOIDANCE_SET_BASED] > least[AVOIDANCE_SWITCHED]
    assert least[AVOIDANCE_SET_BASED] > KEEP_OUT - 0.5 * noise


def to_goal(position: np.ndarray) -> np.ndarray:
    return limit_norm(np.array([4.0, 0, 0]) - position, 1.0)


@pytest.mark.parametrize("rule", [AVOIDANCE_SET_BASED, AVOIDANCE_SWITCHED])
def test_a_goal_straight_behind_is_a_dead_end(rule: int) -> None:
    positions, _, _, _ = fly(config_of(rule), to_goal, (-4.0, 0, 0), standing(*ROCK), 25.0)
    np.testing.assert_allclose(positions[-1], [-KEEP_OUT, 0, 0], atol=0.02)


def test_circulation_leads_out_of_the_dead_end() -> None:
    config = config_of(circulation=0.6)
    positions, _, _, memory = fly(config, to_goal, (-4.0, 0, 0), standing(*ROCK), 25.0)
    assert np.linalg.norm(positions, axis=1).min() >= KEEP_OUT - 1e-3
    np.testing.assert_allclose(positions[-1], [4.0, 0, 0], atol=1e-3)
    assert memory[:, USED].sum() == 0  # the encounter is over


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("height", [0.0, 1.0])
def test_circulation_keeps_to_the_side_it_is_on(height: float, side: float) -> None:
    near = standing(object_at((0.0, 0, height)))
    start = (-4.0, 0.05 * side, 0.0)
    positions, _, _, _ = fly(config_of(circulation=0.6), to_goal, start, near, 25.0)
    assert (side * positions[:, 1]).min() > -0.01
    assert (side * positions[:, 1]).max() > 0.2
    np.testing.assert_allclose(positions[-1], [4.0, 0, 0], atol=1e-3)


def test_time_out_takes_the_other_side_of_a_wall() -> None:
    """A wall of spheres whose left end is far: the side first taken leads nowhere in time."""
    wall = standing(*(object_at((0.0, 1.2 * k, 0.0)) for k in range(-1, 12)))
    side = {}
    for timeout in (1e9, 3.0):
        config = config_of(circulation=0.6, timeout_s=timeout)
        memory, position, sides = empty_memory(), np.array([-2.0, 0.3, 0.0]), set()
        for _ in range(1500):
            top, velocity = result(position, to_goal(position), wall(0.0), config, memory)
            memory = top.memory
            sides |= set(memory[memory[:, USED] > 0.0, SIDE])
            position = position + DT * velocity
        side[timeout] = sides
    assert len(side[3.0]) == 2


@pytest.mark.parametrize(("count", "aside_m"), [(2, 0.01), (3, 0.0), (5, 0.0)])
def test_all_around_a_circle_change_places(count: int, aside_m: float) -> None:
    """No talking: nobody comes into a keep-out, and all pass on the right.

    Rings of five that are symmetric to the last bit stop in the middle: a deadlock, which they leave.
    """
    dt, lag, keep_out = 0.02, 0.2, 0.5
    config = braking(margin_m=0.1, circulation=0.6, lag_s=lag)
    angles = 2.0 * np.pi * np.arange(count) / count
    places = 3.0 * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    goals, speeds = -places, np.zeros((count, 3))
    places += aside_m * np.random.default_rng(count).normal(size=places.shape)
    memories = [empty_memory() for _ in range(count)]
    climbs = [config._replace(climb=0.125 * (uav + 1)) for uav in range(count)]
    standing, stood = np.zeros(count), 0.0
    nearest = np.inf
    for _ in range(1500):
        commands = np.zeros((count, 3))
        for uav in range(count):
            others = [k for k in range(count) if k != uav]
            near = np.stack([object_at(places[k], speeds[k], keep_out) for k in others])
            wanted = limit_norm(goals[uav] - places[uav], 1.5)
            place = FormationPlace(goals[uav] - places[uav], np.zeros(3))
            asked = way_out(wanted, place, standing[uav], climbs[uav])
            view = ObstacleView(
                near, 0.0, memories[uav], dt, speeds[uav], speeds[uav], 0.0, NO_DRIFT, NOTHING_TOLD
            )
            top = clearance(places[uav], asked, view, config)
            memories[uav] = top.memory
            commands[uav] = compose_with_clearance(top, FREE).velocity
            still = len(top.jacobian) > 0 and stands_still(wanted, commands[uav], place)
            standing[uav] = standing_time(standing[uav], still, dt, config)
            stood = max(stood, standing[uav])
            nearest = min(nearest, np.linalg.norm(places[others] - places[uav], axis=1).min())
        speeds = speeds + dt / lag * (commands - speeds)
        places = places + dt * speeds
    assert nearest >= keep_out
    assert (stood >= config.deadlock_s) == (count > 3 and aside_m == 0.0)
    assert np.linalg.norm(places - goals, axis=1).max() < 0.05
