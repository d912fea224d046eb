"""Clearance: the closed form for one obstacle, least change for many, and a way out of dead ends."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.algebra import limit_norm
from ptnsbc_core.behaviours.contract import FormationPlace
from ptnsbc_core.behaviours.deadlock import standing_time, stands_still, way_out
from ptnsbc_core.nullspace import compose_with_clearance
from ptnsbc_core.tasks.approach import LATENCIES, braking_speed, clear_velocities, tangent
from ptnsbc_core.tasks.clearance import ClearanceTask, ObstacleView, clearance, constraints
from ptnsbc_core.tasks.obstacle_memory import SIDE, USED, empty_memory
from ptnsbc_core.tasks.told_path import ToldPaths
from ptnsbc_core.timebase import h, h_rate, step_gain
from ptnsbc_core.types import (
    AVOIDANCE_OFF,
    AVOIDANCE_SET_BASED,
    AVOIDANCE_SWITCHED,
    PROFILE_PAPER,
    SPEED_BRAKING,
    SPEED_LINEAR,
    ClearanceConfig,
    LoopGain,
)

clear_velocities = on_arrays(clear_velocities)
clearance = on_arrays(clearance)
constraints = on_arrays(constraints)
compose_with_clearance = on_arrays(compose_with_clearance)
limit_norm = on_arrays(limit_norm)
tangent = on_arrays(tangent)
stands_still, way_out = on_arrays(stands_still), on_arrays(way_out)

DT, KAPPA, KEEP_OUT, LAG = 0.01, 3.0, 1.5, 0.2
FREE = np.inf
FIRST = KAPPA + step_gain(0.0, DT, 1.0, 1e-2)
"""alpha of the first tick inside, where the encounter's time base has only begun to rise."""

NOTHING_TOLD = ToldPaths(0.0, 0.0, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, np.empty((0, 4)), 0.0, 0.0)

seeds = st.integers(0, 2**31)


def config_of(rule: int = AVOIDANCE_SET_BASED, **changes) -> ClearanceConfig:
    gain = LoopGain(1.0, 1e-2, 1.0, KAPPA, PROFILE_PAPER)
    linear = ClearanceConfig(
        rule,
        0.0,
        gain,
        0.0,
        0.5,
        1e9,
        1.0,
        SPEED_LINEAR,
        6.0,
        6.0,
        LAG,
        1.0 / LAG,
        0.05,
        0.5,
        4.0,
        4.0,
        0.1,
    )
    return linear._replace(**changes)


def object_at(centre, velocity=(0.0, 0.0, 0.0), keep_out: float = KEEP_OUT) -> np.ndarray:
    return np.array([*centre, keep_out, *velocity], dtype=float)


def result(
    position,
    wanted,
    near,
    config,
    memory=None,
    age: float = 0.0,
    velocity=(0.0, 0.0, 0.0),
    command=None,
    told=NOTHING_TOLD,
):
    """The clearance task and the composed velocity; without a command the UAV has the one it flies."""
    memory = empty_memory() if memory is None else memory
    velocity = np.asarray(velocity, dtype=float)
    command = velocity if command is None else np.asarray(command, dtype=float)
    view = ObstacleView(near, age, memory, DT, velocity, command, 0.0, told)
    top: ClearanceTask = clearance(position, wanted, view, config)
    return top, compose_with_clearance(top, FREE).velocity


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


ROCK = standing(object_at((0.0, 0, 0)))


def eastwards(_: np.ndarray) -> np.ndarray:
    return np.array([1.0, 0.0, 0.0])


def test_inside_pushes_out() -> None:
    positions, _, _, _ = fly(config_of(), lambda _: np.zeros(3), (0.3, 0.4, 0), ROCK, 3.0)
    distance = np.linalg.norm(positions, axis=1)
    assert np.all(np.diff(distance) >= 0.0)
    assert distance[100] > KEEP_OUT - 0.02  # the encounter's time base: 1 m to its residual in 1 s
    assert distance[-1] == pytest.approx(KEEP_OUT, abs=1e-3)


def test_printed_34_switches_avoidance_off_inside() -> None:
    """max(d, d_d) is d_d inside, so the printed error d_d - max(d, d_d) is zero where it must not be."""
    for distance in (0.1, 0.8, 1.4):
        assert KEEP_OUT - max(distance, KEEP_OUT) == 0.0
        top, _ = result(np.array([distance, 0, 0]), np.zeros(3), ROCK(0.0), config_of())
        assert top.velocity[0] == pytest.approx(FIRST * (KEEP_OUT - distance))


def test_a_moving_object_is_given_way_to() -> None:
    def passing(t: float) -> np.ndarray:
        return object_at((-6.0 + t, 0.2, 0.0), (1.0, 0, 0))[np.newaxis]

    positions, _, _, _ = fly(config_of(), lambda p: -p, (0.0, 0, 0), passing, 12.0)
    centres = np.stack([passing((k + 1) * DT)[0, 0:3] for k in range(len(positions))])
    assert np.linalg.norm(positions - centres, axis=1).min() >= KEEP_OUT - 1e-3
    assert np.linalg.norm(positions[-1]) < 0.05


def test_set_based_is_continuous_across_the_boundary() -> None:
    wanted = np.array([1.0, 0.3, 0.0])
    places = np.linspace(1.0, 3.0, 4001)
    found = [result(np.array([-x, 0.2, 0]), wanted, ROCK(0.0), config_of())[1] for x in places]
    assert np.abs(np.diff(found, axis=0)).max() < 5.0 * KAPPA * (places[1] - places[0])
    config = config_of(AVOIDANCE_SWITCHED)
    jumps = [result(np.array([-x, 0.2, 0]), wanted, ROCK(0.0), config)[1] for x in places]
    assert np.abs(np.diff(jumps, axis=0)).max() > 0.5


@pytest.mark.parametrize(("noise", "ratio"), [(0.0, 3.0), (0.01, 3.0), (0.02, 3.0)])
def test_switched_chatters_where_set_based_glides(noise: float, ratio: float) -> None:
    """A pass 0.6 m off the centre: total variation of the velocity, and changes of the task stack."""
    moved, changes, least = {}, {}, {}
    for rule in (AVOIDANCE_SET_BASED, AVOIDANCE_SWITCHED):
        start = (-4.0, 0.6, 0.0)
        positions, velocities, rows, _ = fly(config_of(rule), eastwards, start, ROCK, 10.0, noise)
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
    positions, _, _, _ = fly(config_of(rule), to_goal, (-4.0, 0, 0), ROCK, 25.0)
    np.testing.assert_allclose(positions[-1], [-KEEP_OUT, 0, 0], atol=0.02)


def test_circulation_leads_out_of_the_dead_end() -> None:
    config = config_of(circulation=0.6)
    positions, _, _, memory = fly(config, to_goal, (-4.0, 0, 0), ROCK, 25.0)
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


def test_without_rule_or_objects_nothing_changes() -> None:
    wanted = np.array([1.0, 2, 3])
    for rule, near in ((AVOIDANCE_OFF, ROCK(0.0)), (AVOIDANCE_SET_BASED, np.empty((0, 7)))):
        top, velocity = result(np.array([0.5, 0, 0]), wanted, near, config_of(rule))
        np.testing.assert_array_equal(velocity, wanted)
        assert top.jacobian.shape == (0, 3)


def test_an_object_at_the_same_place_asks_for_nothing() -> None:
    _, velocity = result(np.zeros(3), np.ones(3), ROCK(0.0), config_of())
    np.testing.assert_array_equal(velocity, np.ones(3))


def test_margin_adds_to_the_keep_out() -> None:
    position, near = np.array([2.0, 0, 0]), ROCK(0.0)
    _, velocity = result(position, np.zeros(3), near, config_of(margin_m=0.8))
    assert velocity[0] == pytest.approx(FIRST * 0.3)


# --- approach: braking


def braking(**changes) -> ClearanceConfig:
    return config_of(approach=SPEED_BRAKING, **changes)


@given(room=st.floats(0.01, 3.0), speed=st.floats(0.0, 9.0))
def test_a_standing_object_straight_ahead_is_approached_no_faster_than_can_be_braked(
    room: float, speed: float
) -> None:
    """From rest: the closed form of room, deceleration and lag."""
    near = object_at((KEEP_OUT + room, 0, 0))[np.newaxis]
    _, velocity = result(np.zeros(3), np.array([speed, 0, 0]), near, braking())
    allowed = braking_speed(room, 6.0, LATENCIES * LAG)
    assert velocity[0] == pytest.approx(min(speed, allowed))


def test_what_the_motion_needs_already_is_not_there_for_braking() -> None:
    near = object_at((3.0, 0, 0))[np.newaxis]
    for demand, left in ((0.0, 6.0), (2.0, 4.0), (50.0, 1.5)):
        view = ObstacleView(
            near, 0.0, empty_memory(), DT, np.zeros(3), np.zeros(3), demand, NOTHING_TOLD
        )
        top = clearance(np.zeros(3), np.array([9.0, 0, 0]), view, braking())
        speed = compose_with_clearance(top, FREE).velocity[0]
        assert speed == pytest.approx(braking_speed(1.5, left, LATENCIES * LAG))


def test_a_pass_that_stays_clear_is_left_alone() -> None:
    """Linear slows it, whatever the side on which it passes; braking does not."""
    velocity = np.array([3.0, 0, 0])
    near = object_at((3.0, -1.6, 0))[np.newaxis]
    top, found = result(np.zeros(3), velocity, near, braking(), velocity=velocity)
    np.testing.assert_array_equal(found, velocity)
    assert top.jacobian.shape == (0, 3)
    closer = object_at((3.0, -1.4, 0))[np.newaxis]
    top, found = result(np.zeros(3), velocity, closer, braking(), velocity=velocity)
    assert top.jacobian.shape == (1, 3)
    assert found[1] > 0.0


def test_two_that_meet_straight_on_each_make_half_of_the_change_to_the_same_side() -> None:
    """All is mirrored: their changes sum to nothing, and both pass on the right."""
    place, speed = np.array([3.0, 0, 0]), np.array([2.0, 0, 0])
    first = result(
        np.zeros(3), speed, object_at(place, -speed, 0.5)[np.newaxis], braking(), velocity=speed
    )[1]
    second = result(
        place, -speed, object_at((0, 0, 0), speed, 0.5)[np.newaxis], braking(), velocity=-speed
    )[1]
    np.testing.assert_allclose(first, -second, atol=1e-12)
    assert first[1] < -0.1
    # together they are out of the cone of collision, alone neither is
    relative = first - second
    assert abs(relative[1]) / np.linalg.norm(relative) == pytest.approx(0.5 / 3.0, abs=1e-9)


@given(seed=seeds)
def test_half_of_what_a_pair_is_blown_off_by_is_no_reason_to_give_way(seed: int) -> None:
    """Both move by the same velocity and are told to stop: the bound is half of that velocity lower."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(2.2, 3.5) * tangent(rng.normal(size=3))
    common = rng.uniform(0.1, 1.5) * -place / np.linalg.norm(place)
    near = object_at(place, common)[np.newaxis]
    still, blown = (
        constraints(np.zeros(3), view, braking())
        for view in (
            ObstacleView(near, 0.0, empty_memory(), DT, common, common, 0.0, NOTHING_TOLD),
            ObstacleView(near, 0.0, empty_memory(), DT, common, np.zeros(3), 0.0, NOTHING_TOLD),
        )
    )
    moved = still.bound[0] - blown.bound[0]
    assert moved == pytest.approx(0.5 * still.normals[0] @ common)


@given(t=st.floats(1.0, 4.0))
def test_a_neighbour_whose_told_path_ends_clear_is_left_alone(t: float) -> None:
    """On straight paths the two would meet; they stop 1.2 m apart. Without slots they give way."""
    slots = np.array([[1.2, 0.0, 0.0, 0.6]])
    told = ToldPaths(t, 5.0, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, slots, 0.6, 0.0)
    left, rate = 1.0 - h(t / 5.0), h_rate(t / 5.0, 5.0)
    own, other = np.array([-4.0, 0, 0]), np.array([4.0, 0, 0])  # start errors
    place, velocity = own * left, -own * rate
    near = object_at((1.2 + other[0] * left, 0, 0), -other * rate, 0.5)[np.newaxis]
    top, found = result(place, velocity, near, braking(), velocity=velocity, told=told)
    np.testing.assert_array_equal(found, velocity)
    assert top.jacobian.shape == (0, 3)
    closing, room = 8.0 * rate, 1.2 + 8.0 * left - 0.5
    if closing > braking_speed(room, 6.0, LATENCIES * (LAG + 0.05)):
        top, _ = result(place, velocity, near, braking(), velocity=velocity)
        assert top.jacobian.shape == (1, 3)


@given(seed=seeds)
def test_halves_of_a_pair_sum_to_the_whole_change(seed: int) -> None:
    """Two that lag by opposite velocities are told the edge of the cone and half of what the pair lags by."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(2.0, 3.5) * tangent(rng.normal(size=3))
    here, there = rng.normal(size=(2, 3))
    lag = 0.3 * rng.normal(size=3)
    config = braking(margin_m=0.0)
    first = ObstacleView(
        object_at(place, there)[None], 0.0, empty_memory(), DT, here, here + lag, 0.0, NOTHING_TOLD
    )
    other = ObstacleView(
        object_at((0, 0, 0), here)[None],
        0.0,
        empty_memory(),
        DT,
        there,
        there - lag,
        0.0,
        NOTHING_TOLD,
    )
    one, two = constraints(np.zeros(3), first, config), constraints(place, other, config)
    late = LAG + config.sensor_s
    allowed = braking_speed(np.linalg.norm(place) - KEEP_OUT, 6.0, LATENCIES * late)
    space = clear_velocities(-place, KEEP_OUT, here - there, allowed)
    np.testing.assert_allclose(one.normals, -two.normals, atol=1e-9)
    assert one.bound[0] + two.bound[0] == pytest.approx(
        space.bound + 0.5 * space.normal @ (lag - -lag), abs=1e-9
    )


def test_a_neighbour_at_06_m_still_counts_after_two_seconds_of_silence() -> None:
    """It moved away when it was last seen: extrapolated for two seconds it asked for nothing."""
    near = object_at((0.6, 0, 0), (1.5, 0, 0), 0.5)[np.newaxis]
    wanted = np.array([2.0, 0, 0])
    for config in (config_of(stale_s=0.5), braking(stale_s=0.5)):
        _, velocity = result(np.zeros(3), wanted, near, config, age=2.0)
        assert velocity[0] <= KAPPA * 0.1 + 1e-9
        forgotten, _ = result(np.zeros(3), wanted, near, config._replace(stale_s=9.0), age=2.0)
        np.testing.assert_array_equal(forgotten.secondary, wanted)


@given(age=st.floats(0.51, 60.0), rule=st.sampled_from([AVOIDANCE_SET_BASED, AVOIDANCE_SWITCHED]))
def test_a_silent_sensor_makes_slow_whatever_it_saw(age: float, rule: int) -> None:
    """No faster than the UAV can stop within the range of the sensor, which falls with the silence."""
    config = config_of(rule, approach=SPEED_BRAKING)
    _, velocity = result(np.zeros(3), np.array([5.0, 5.0, 0]), np.empty((0, 7)), config, age=age)
    assert np.linalg.norm(velocity) == pytest.approx(
        braking_speed(4.0, 6.0, LATENCIES * (LAG + age))
    )
    off = config_of(AVOIDANCE_OFF)
    _, velocity = result(np.zeros(3), np.array([5.0, 5.0, 0]), np.empty((0, 7)), off, age=age)
    np.testing.assert_array_equal(velocity, [5.0, 5.0, 0])


@pytest.mark.parametrize(("distance", "aside"), [(3.0, 0.0), (0.62, 0.3)])
def test_sideways_motion_around_what_moves_only_where_there_is_no_progress(
    distance: float, aside: float
) -> None:
    """3 m away it closes in, slower than it wants to. At arm's length, behind one that stands in the way, it turns."""
    straight, turning = (braking(circulation=gain) for gain in (0.0, 0.6))
    near = np.array([object_at((distance, 0.0, 0.0), (1e-6, 0.0, 0.0), 0.5)])
    memory, wanted = empty_memory(), np.array([4.0, 0.0, 0.0])
    for _ in range(100):
        top, turned = result(np.zeros(3), wanted, near, turning, memory)
        memory = top.memory
    _, closing = result(np.zeros(3), wanted, near, straight, memory)
    assert len(top.jacobian) == 1
    sideways = np.linalg.norm(np.subtract(turned, closing))
    assert sideways == pytest.approx(0.0, abs=1e-9) if aside == 0.0 else sideways > aside


@pytest.mark.parametrize("aside_m", [0.0, 0.01])
@pytest.mark.parametrize("count", [2, 3, 5, 8])
def test_all_around_a_circle_change_places(count: int, aside_m: float) -> None:
    """No talking: nobody comes into a keep-out, and all pass on the right.

    Rings of five and eight that are symmetric to the last bit stop in the middle: a deadlock, which they leave.
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
                near, 0.0, memories[uav], dt, speeds[uav], speeds[uav], 0.0, NOTHING_TOLD
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
