"""Clearance: the closed form for one obstacle, and the least change for many."""

from itertools import combinations

import numpy as np
import pytest
from clearance_case import FIRST, KAPPA, KEEP_OUT, ROCK, config_of, object_at, result, seeds
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.tasks.near_constraints import empty_memory
from ptnsbc_core.types import AVOIDANCE_OFF, AVOIDANCE_SET_BASED, AVOIDANCE_SWITCHED


@given(seed=seeds)
def test_one_object_is_the_closed_form(seed: int) -> None:
    """v = v_F + [-alpha (d - d_d) - n.(v_F - v_o)]_+ n, moving object or not, inside or outside."""
    rng = np.random.default_rng(seed)
    position, wanted, moving = rng.normal(size=(3, 3))
    near = object_at(rng.normal(size=3), moving)[np.newaxis]
    n = position - near[0, 0:3]
    d = np.linalg.norm(n)
    n = n / d
    alpha = FIRST if d < KEEP_OUT else KAPPA
    lack = -alpha * (d - KEEP_OUT) - n @ (wanted - moving)
    top, velocity = result(position, wanted, near, config_of())
    np.testing.assert_allclose(velocity, wanted + max(lack, 0.0) * n, atol=1e-12)
    assert top.jacobian.shape[0] == int(lack > 0.0)


def test_alpha_is_rearmed_at_every_encounter_inside() -> None:
    """Inside, the time base of the encounter adds to kappa: it has reached its peak after half a second."""
    near = object_at((0.0, 0, 0))[np.newaxis]
    position, memory, pushes = np.array([1.0, 0.0, 0.0]), empty_memory(), []
    for _ in range(120):
        top, velocity = result(position, np.zeros(3), near, config_of(), memory)
        memory = top.memory
        pushes.append(velocity[0])
    assert pushes[0] == pytest.approx(FIRST * 0.5)
    assert max(pushes) == pytest.approx((KAPPA + 2.7228 * 5.0) * 0.5, rel=0.08)
    assert pushes[-1] == pytest.approx(KAPPA * 0.5)


def least_change(wanted: np.ndarray, normals: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Nearest admissible velocity by trying all sets of binding rows."""
    best = None
    for count in range(4):
        for rows in combinations(range(len(least)), count):
            a, b = normals[list(rows)], least[list(rows)]
            v = wanted + np.linalg.pinv(a) @ (b - a @ wanted) if rows else wanted
            if np.all(normals @ v >= least - 1e-9):
                size = np.linalg.norm(v - wanted)
                best = v if best is None or size < np.linalg.norm(best - wanted) else best
    return best


def independence(rows: np.ndarray) -> float:
    """Smallest singular value of any two or three of the unit rows."""
    sets = [list(of) for count in (2, 3) for of in combinations(range(len(rows)), count)]
    return min(np.linalg.svd(rows[of], compute_uv=False)[-1] for of in sets)


def directions_ahead(rng: np.random.Generator, count: int) -> np.ndarray:
    """Unit vectors (count, 3) on the side of +x."""
    directions = rng.normal(size=(count, 3))
    directions[:, 0] = np.abs(directions[:, 0]) + 1.0
    return directions / np.linalg.norm(directions, axis=1)[:, np.newaxis]


def directions_apart(rng: np.random.Generator, count: int) -> np.ndarray:
    """The same, far enough from one line or plane for 60 sweeps to converge."""
    while True:
        directions = directions_ahead(rng, count)
        if independence(directions) >= 0.5:
            return directions


@given(seed=seeds, count=st.integers(2, 3))
def test_many_objects_are_kept_clear_of_with_the_least_change(seed: int, count: int) -> None:
    """All on one side, so that the demands do not contradict each other.

    Normals of four are never independent: the sweeps then converge slowly, and end some mm/s beside the least change.
    """
    rng = np.random.default_rng(seed)
    directions = directions_apart(rng, count)
    distances = rng.uniform(1.4, 2.0, count)
    near = np.stack([object_at(distances[m] * directions[m]) for m in range(count)])
    wanted = rng.normal(size=3) + np.array([2.0, 0, 0])
    normals = -directions
    demanded = np.where(distances < KEEP_OUT, FIRST, KAPPA) * (KEEP_OUT - distances)
    expected = least_change(wanted, normals, demanded)
    top, velocity = result(np.zeros(3), wanted, near, config_of())
    assert np.all(normals @ velocity >= demanded - 1e-6)
    np.testing.assert_allclose(velocity, expected, atol=1e-6)
    # only rows that bind are tasks, and the task's velocity is all in their row space
    np.testing.assert_allclose(top.jacobian @ velocity, top.jacobian @ top.velocity, atol=1e-6)


@given(seed=seeds, count=st.integers(2, 4))
def test_no_demand_of_many_is_missed_by_more_than_what_sixty_sweeps_leave(
    seed: int, count: int
) -> None:
    """The normals may lie in one plane: the largest lack was 14 mm/s in 18000 draws."""
    rng = np.random.default_rng(seed)
    directions = directions_ahead(rng, count)
    distances = rng.uniform(1.4, 2.0, count)
    near = np.stack([object_at(distances[m] * directions[m]) for m in range(count)])
    demanded = np.where(distances < KEEP_OUT, FIRST, KAPPA) * (KEEP_OUT - distances)
    _, velocity = result(np.zeros(3), rng.normal(size=3) + np.array([2.0, 0, 0]), near, config_of())
    assert np.all(-directions @ velocity >= demanded - 0.02)


def test_between_two_objects_neither_is_given_up() -> None:
    near = np.stack([object_at((1.4, 1.0, 0)), object_at((1.4, -1.0, 0))])
    top, velocity = result(np.zeros(3), np.array([1.0, 0.1, 0]), near, config_of())
    assert top.jacobian.shape[0] == 2
    for row in near:
        n = -row[0:3] / np.linalg.norm(row[0:3])
        assert n @ velocity >= KAPPA * (KEEP_OUT - np.linalg.norm(row[0:3])) - 1e-6
    assert velocity[2] == 0.0


def test_what_was_seen_some_time_ago_has_moved_on() -> None:
    position, wanted, moving = np.array([3.0, 0, 0]), np.zeros(3), (2.0, 0.0, 0.0)
    seen = object_at((0.0, 0, 0), moving)[np.newaxis]
    now = object_at((0.6, 0, 0), moving)[np.newaxis]
    _, one = result(position, wanted, seen, config_of(), age=0.3)
    _, other = result(position, wanted, now, config_of())
    np.testing.assert_allclose(one, other, atol=1e-12)


def test_printed_34_switches_avoidance_off_inside() -> None:
    """max(d, d_d) is d_d inside, so the printed error d_d - max(d, d_d) is zero where it must not be."""
    for distance in (0.1, 0.8, 1.4):
        assert KEEP_OUT - max(distance, KEEP_OUT) == 0.0
        top, _ = result(np.array([distance, 0, 0]), np.zeros(3), ROCK, config_of())
        assert top.velocity[0] == pytest.approx(FIRST * (KEEP_OUT - distance))


def test_set_based_is_continuous_across_the_boundary() -> None:
    wanted = np.array([1.0, 0.3, 0.0])
    places = np.linspace(1.0, 3.0, 4001)
    found = [result(np.array([-x, 0.2, 0]), wanted, ROCK, config_of())[1] for x in places]
    assert np.abs(np.diff(found, axis=0)).max() < 5.0 * KAPPA * (places[1] - places[0])
    config = config_of(AVOIDANCE_SWITCHED)
    jumps = [result(np.array([-x, 0.2, 0]), wanted, ROCK, config)[1] for x in places]
    assert np.abs(np.diff(jumps, axis=0)).max() > 0.5


def test_without_rule_or_objects_nothing_changes() -> None:
    wanted = np.array([1.0, 2, 3])
    for rule, near in ((AVOIDANCE_OFF, ROCK), (AVOIDANCE_SET_BASED, np.empty((0, 8)))):
        top, velocity = result(np.array([0.5, 0, 0]), wanted, near, config_of(rule))
        np.testing.assert_array_equal(velocity, wanted)
        assert top.jacobian.shape[0] == 0


def test_an_object_at_the_same_place_asks_for_nothing() -> None:
    _, velocity = result(np.zeros(3), np.ones(3), ROCK, config_of())
    np.testing.assert_array_equal(velocity, np.ones(3))


def test_margin_adds_to_the_keep_out() -> None:
    position, near = np.array([2.0, 0, 0]), ROCK
    _, velocity = result(position, np.zeros(3), near, config_of(margin_m=0.8))
    assert velocity[0] == pytest.approx(FIRST * 0.3)
