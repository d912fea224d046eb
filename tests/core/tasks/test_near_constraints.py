"""Approach speed: the closed forms, and a vehicle with lag and limited braking that never crosses the line."""

import numpy as np
import pytest
from clearance_case import NO_DRIFT, NOTHING_TOLD, braking, object_at
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.tasks.near_constraints import (
    COMMON,
    LATENCIES,
    QUIET_S,
    SHARE,
    SIDE,
    SLOTS,
    USED,
    ObstacleView,
    active_time,
    braking_speed,
    clear_velocities,
    constraint,
    empty_memory,
    find_slot,
    side_of,
    surely_kept,
    tangent,
    update_memory,
)
from ptnsbc_core.types import (
    PROFILE_PAPER,
    SPEED_BRAKING,
    SPEED_LINEAR,
    ClearanceConfig,
    LoopGain,
    VelocityLoop,
)

clear_velocities = on_arrays(clear_velocities)
tangent = on_arrays(tangent)

rooms = st.floats(0.0, 50.0)
brakes = st.floats(0.5, 20.0)
lags = st.floats(0.02, 0.5)
seeds = st.integers(0, 2**31)


@given(room=rooms, brake=brakes, latency=st.floats(0.01, 3.0))
def test_room_is_what_the_latency_and_the_braking_use_up(
    room: float, brake: float, latency: float
) -> None:
    speed = braking_speed(room, brake, latency)
    assert speed * latency + speed * speed / (2.0 * brake) == pytest.approx(room, abs=1e-9)


@given(brake=brakes, latency=st.floats(0.05, 3.0), room=st.floats(0.0, 10.0))
def test_slope_is_that_of_the_latency_at_the_line_and_the_braking_stays_below_the_limit(
    brake: float, latency: float, room: float
) -> None:
    step = 1e-6
    start = braking_speed(step, brake, latency) / step
    assert start == pytest.approx(1.0 / latency, rel=1e-3)
    here, there = (braking_speed(r, brake, latency) for r in (room, room + step))
    slope = (there - here) / step
    assert slope == pytest.approx(brake / (here + brake * latency), rel=1e-3, abs=1e-6)
    assert here * slope <= brake


@given(brake=brakes, lag=lags, room=st.floats(0.05, 20.0), delayed=st.booleans())
def test_a_vehicle_with_this_lag_and_this_braking_never_crosses(
    brake: float, lag: float, room: float, delayed: bool
) -> None:
    """A double integrator that follows the bound, by a first-order lag or by a dead time."""
    dt = min(lag / 50.0, 0.004)
    behind = max(round(lag / dt), 1)
    speed = braking_speed(room, brake, LATENCIES * lag)
    seen = [room + speed * dt * k for k in range(behind, -1, -1)]
    for _ in range(4000):
        known = seen[-1 - behind] if delayed else seen[-1]
        wanted = braking_speed(max(known, 0.0), brake, LATENCIES * lag)
        rate = (wanted - speed) / (dt if delayed else lag)
        speed += dt * float(np.clip(rate, -brake, brake))
        room -= dt * speed
        seen.append(room)
        assert room > -1e-6


def enters(away: np.ndarray, keep_out: float, relative: np.ndarray, horizon: float) -> bool:
    """Whether a straight relative motion comes into the sphere within the horizon."""
    times = np.linspace(0.0, horizon, 2001)[:, np.newaxis]
    return bool(np.linalg.norm(away + times * relative, axis=1).min() < keep_out - 1e-6)


@given(seed=seeds)
def test_every_velocity_of_the_half_space_is_clear(seed: int) -> None:
    rng = np.random.default_rng(seed)
    keep_out = rng.uniform(0.3, 2.0)
    away = rng.normal(size=3)
    away *= (keep_out + rng.uniform(0.01, 4.0)) / np.linalg.norm(away)
    allowed = rng.uniform(0.1, 4.0)
    horizon = (np.linalg.norm(away) - keep_out) / allowed
    space = clear_velocities(away, keep_out, rng.normal(size=3) * 3.0, allowed)
    assert np.linalg.norm(space.normal) == pytest.approx(1.0)
    for velocity in rng.normal(size=(20, 3)) * 3.0:
        lack = max(space.bound - space.normal @ velocity, 0.0)
        assert not enters(away, keep_out, velocity + lack * space.normal, horizon)


def ellipsoid_view(seed: int) -> tuple[np.ndarray, ObstacleView, np.ndarray]:
    """A place outside of an ellipsoid around the origin, its view of it, and the semi-axes with the margin."""
    rng = np.random.default_rng(seed)
    radius, height, margin = rng.uniform(0.1, 1.0), rng.uniform(1.0, 4.0), 0.05
    axes = np.array([radius, radius, radius * height]) + margin
    away = rng.normal(size=3)
    place = axes * away / np.linalg.norm(away) * rng.uniform(1.01, 4.0)
    near = np.array([[0.0, 0.0, 0.0, radius, 0.0, 0.0, 0.0, radius * height]])
    velocity = tuple(rng.normal(size=3) * 2.0)
    view = ObstacleView(
        near, 0.0, empty_memory(), DT, velocity, velocity, 0.0, NO_DRIFT, NOTHING_TOLD
    )
    return place, view, axes


@given(seed=seeds)
def test_every_velocity_that_an_ellipsoid_leaves_is_clear_of_it(seed: int) -> None:
    """Within the time in which the vehicle stops."""
    place, view, axes = ellipsoid_view(seed)
    config = CONFIG._replace(approach=SPEED_BRAKING, margin_m=0.05)
    row = constraint(tuple(place), 0, view, False, config)
    level = place / axes
    room = (np.linalg.norm(level) - 1.0) * axes[0]
    assert row.depth == pytest.approx(-room)
    grows = np.linalg.norm(level / axes) / np.linalg.norm(level) * axes[0]  # per metre flown away
    allowed = braking_speed(room, 6.0 * grows, LATENCIES * config.lag_s)
    for velocity in np.random.default_rng(seed).normal(size=(20, 3)) * 2.0:
        lack = max(row.bound - np.dot(row.normal, velocity), 0.0)
        flown = (velocity + lack * np.array(row.normal)) / axes
        assert not enters(level, 1.0, flown, room / allowed)


@given(seed=seeds)
def test_the_linear_bound_of_an_ellipsoid_is_the_decay_of_its_depth(seed: int) -> None:
    place, view, _ = ellipsoid_view(seed)
    config = CONFIG._replace(margin_m=0.05)
    row = constraint(tuple(place), 0, view, False, config)
    assert np.linalg.norm(row.normal) == pytest.approx(1.0)
    later = place + 1e-6 * row.bound * np.array(row.normal)
    rate = (constraint(tuple(later), 0, view, False, config).depth - row.depth) / 1e-6
    assert rate == pytest.approx(-GAIN.kappa * row.depth, rel=1e-3, abs=1e-6)


def pair_latency(lag: float) -> float:
    """T of filter, vehicle, control period and sensor."""
    return LATENCIES * (2.0 * lag + 0.01 + 0.05)


def least_room(speed: float, room: float, gives_way: bool, lag: float) -> float:
    """Two that fly straight at each other, by the shares, the command filter and the lag of the vehicle.

    The filter is as slow as the vehicle. The other one mirrors the UAV, or goes on at its speed.
    """
    brake, dt, steps = 6.87, 0.01, 10
    bandwidth, latency = 1.0 / lag, pair_latency(lag)
    own = command = -speed  # away from the other one
    least = room
    for _ in range(1000):
        other = own if gives_way else -speed
        allowed = braking_speed(max(room, 0.0), brake, latency)
        lacking = -allowed - (own + other)
        wanted = max(own + COMMON * (command - own) + SHARE * lacking, -speed)
        command += dt * float(np.clip(bandwidth * (wanted - command), -brake, brake))
        for _ in range(steps):
            own += dt / steps * float(np.clip((command - own) / lag, -brake, brake))
            room += dt / steps * (own + (own if gives_way else -speed))
        least = min(least, room)
    return least


@pytest.mark.parametrize("lag", [0.05, 0.135, 0.2])
@pytest.mark.parametrize("gives_way", [True, False])
def test_a_pair_keeps_out_whether_the_other_one_gives_way_or_not(
    gives_way: bool, lag: float
) -> None:
    """From outside the bound, and at the bound: half of the change is enough, alone it comes to the whole."""
    for speed in (0.1, 1.0):
        closing = 2.0 * speed
        at_the_bound = closing * pair_latency(lag) + 0.5 * closing**2 / 6.87
        for room in (at_the_bound, 1.5 * at_the_bound):
            assert least_room(speed, room, gives_way, lag) > -2e-3  # of a margin of 0.02


@given(seed=seeds)
def test_both_of_a_pair_turn_the_same_way(seed: int) -> None:
    """What is seen from the other end is turned by half a turn: the normals are opposite."""
    rng = np.random.default_rng(seed)
    away, relative = rng.normal(size=(2, 3))
    away *= 3.0 / np.linalg.norm(away)
    here = clear_velocities(away, 0.5, relative, 1.0)
    there = clear_velocities(-away, 0.5, -relative, 1.0)
    np.testing.assert_allclose(here.normal, -there.normal, atol=1e-12)
    assert here.bound == pytest.approx(there.bound, abs=1e-12)


def test_a_straight_meeting_is_passed_on_the_right() -> None:
    space = clear_velocities(np.array([-3.0, 0, 0]), 0.5, np.array([4.0, 0, 0]), 1.0)
    assert space.bound == 0.0
    np.testing.assert_allclose(space.normal, [-0.5 / 3.0, -np.sqrt(1.0 - 1.0 / 36.0), 0.0])


def test_a_slow_one_may_close_in_as_fast_as_it_can_brake() -> None:
    space = clear_velocities(np.array([-3.0, 0, 0]), 0.5, np.zeros(3), 1.3)
    np.testing.assert_allclose(space.normal, [-1.0, 0, 0])
    assert space.bound == pytest.approx(-1.3)


def test_tangent_is_across_the_normal() -> None:
    for n in np.random.default_rng(1).normal(size=(50, 3)):
        n = n / np.linalg.norm(n)
        way = tangent(n)
        assert np.linalg.norm(way) == pytest.approx(1.0)
        assert way @ n == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(tangent(np.array([1.0, 0, 0])), [0, 1, 0])
    np.testing.assert_allclose(tangent(np.array([0.0, 0, 1.0])), [0, -1, 0])  # nearly vertical


DT = 0.1
GAIN = LoopGain(1.0, 1e-2, 1.0, 3.0, PROFILE_PAPER)
LOOP = VelocityLoop(5.0, 0.0, 0.0)
CONFIG = ClearanceConfig(
    1,
    0.0,
    GAIN,
    0.6,
    0.5,
    2.05,
    1.0,
    SPEED_LINEAR,
    6.0,
    6.0,
    0.2,
    5.0,
    LOOP,
    0.05,
    0.5,
    4.0,
    4.0,
    0.1,
)


def near_of(*centres: tuple[float, float, float]) -> np.ndarray:
    rows = np.zeros((len(centres), 8))
    rows[:, 0:3] = centres
    rows[:, 3] = 1.5
    return rows


def met(memory: np.ndarray, near: np.ndarray, ticks: int = 1, side: float = 1.0, hit: float = 1.0):
    count = near.shape[0]
    for _ in range(ticks):
        memory = update_memory(memory, near, np.full(count, hit), np.full(count, side), DT, CONFIG)
    return memory


def test_a_new_encounter_takes_a_slot_and_the_side_it_is_on() -> None:
    memory = met(empty_memory(), near_of((0, 0, 0), (5, 0, 0)), side=-0.3)
    assert memory[:, USED].sum() == 2
    slot = find_slot(memory, np.array([5.2, 0.1, 0.0]))
    np.testing.assert_allclose(memory[slot], [5, 0, 0, -1, DT, 0, 1])
    assert find_slot(memory, np.array([2.5, 0.0, 0.0])) == -1
    assert met(empty_memory(), near_of((0, 0, 0)), side=0.0)[0, SIDE] == 1.0


def test_what_does_not_bind_is_not_met() -> None:
    np.testing.assert_array_equal(met(empty_memory(), near_of((0, 0, 0)), hit=0.0), empty_memory())


def test_an_encounter_is_followed_while_its_object_moves() -> None:
    memory = empty_memory()
    for k in range(15):
        memory = met(memory, near_of((0.5 * k, 0, 0)))
    assert memory[:, USED].sum() == 1
    assert active_time(memory, (7.0, 0.0, 0.0)) == pytest.approx(15 * DT)


def test_an_encounter_ends_when_it_has_been_quiet() -> None:
    memory = met(empty_memory(), near_of((0, 0, 0)), ticks=5)
    for _ in range(9):
        memory = met(memory, near_of((0, 0, 0)), hit=0.0)
    assert active_time(memory, (0.0, 0.0, 0.0)) == pytest.approx(5 * DT)
    assert memory[0, QUIET_S] == pytest.approx(0.9)
    memory = met(memory, near_of((0, 0, 0)), ticks=2, hit=0.0)
    assert memory[:, USED].sum() == 0
    assert active_time(memory, (0.0, 0.0, 0.0)) == 0.0
    assert met(memory, near_of((0, 0, 0)), side=-1.0)[0, SIDE] == -1.0


def test_around_every_time_out_the_side_changes_without_a_step() -> None:
    memory, length = empty_memory(), CONFIG.timeout_s
    for k in range(1, 200):
        memory = met(memory, near_of((0, 0, 0)))
        turn = max(round(k * DT / length), 1)
        left = np.clip((turn * length - k * DT) / (0.25 * length), -1.0, 1.0)
        expected = left if turn % 2 else -left
        assert side_of(memory, 0, length) == pytest.approx(expected, abs=1e-9)


def test_a_ninth_object_takes_the_slot_that_is_quiet_longest() -> None:
    memory = empty_memory()
    for k in range(SLOTS):
        memory = update_memory(
            memory, near_of((3.0 * k, 0, 0)), np.ones(1), np.ones(1), 0.01, CONFIG
        )
    assert memory[:, USED].sum() == SLOTS
    memory = update_memory(memory, near_of((0, 50, 0)), np.ones(1), np.ones(1), 0.01, CONFIG)
    assert memory[:, USED].sum() == SLOTS
    assert find_slot(memory, np.array([0.0, 50, 0])) == 0
    assert find_slot(memory, np.zeros(3)) == -1


def test_the_memory_given_is_left_alone() -> None:
    memory = met(empty_memory(), near_of((0, 0, 0)))
    before = memory.copy()
    met(memory, near_of((0, 0, 0), (4, 4, 4)), ticks=3)
    np.testing.assert_array_equal(memory, before)


def test_a_constraint_that_is_surely_kept_is_kept() -> None:
    """The look at the distance leaves out no constraint that binds, and hardly one that does not."""
    chance, kept, decided = np.random.default_rng(1), 0, 0
    config = braking(margin_m=0.1, weakest=3.0)

    def vector(size: float) -> tuple[float, float, float]:
        x, y, z = chance.normal(size=3) * size * chance.random()
        return float(x), float(y), float(z)

    for k in range(1500):
        near = object_at(vector(8.0), vector(1.0) if k % 3 else (0.0,) * 3, 0.5 + k % 2)
        own, given, wanted = vector(1.0), vector(1.0), vector(1.0)
        age_s, demand = 0.1 * chance.random(), chance.random()
        view = ObstacleView(
            near[None], age_s, empty_memory(), 0.01, own, given, demand, vector(0.5), NOTHING_TOLD
        )
        place = vector(8.0)
        found = constraint(place, 0, view, True, config)
        is_kept = bool(np.dot(found.normal, wanted) >= found.bound)
        if surely_kept(place, wanted, 0, view, config):
            assert is_kept
            decided += 1
        kept += is_kept
    assert 0.4 * kept < decided < kept < 1500
