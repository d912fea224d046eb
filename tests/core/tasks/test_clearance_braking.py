"""Clearance by braking: speed that can be braked, a pair that shares the change, and a silent sensor."""

import numpy as np
import pytest
from clearance_case import (
    DT,
    FREE,
    KAPPA,
    KEEP_OUT,
    LAG,
    NO_DRIFT,
    NOTHING_TOLD,
    ROCK,
    braking,
    clearance,
    compose_with_clearance,
    config_of,
    object_at,
    result,
    seeds,
)
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays
from scipy.linalg import expm

from ptnsbc_core.curves.turned import ToldPaths
from ptnsbc_core.tasks.near_constraints import (
    LATENCIES,
    ObstacleView,
    braking_speed,
    clear_velocities,
    constraints,
    drift,
    empty_memory,
    tangent,
)
from ptnsbc_core.timebase import h, h_rate
from ptnsbc_core.types import (
    AVOIDANCE_OFF,
    AVOIDANCE_SET_BASED,
    AVOIDANCE_SWITCHED,
    SPEED_BRAKING,
    VelocityLoop,
)

clear_velocities = on_arrays(clear_velocities)
constraints = on_arrays(constraints)
tangent = on_arrays(tangent)
drift = on_arrays(drift)


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
            near, 0.0, empty_memory(), DT, np.zeros(3), np.zeros(3), demand, NO_DRIFT, NOTHING_TOLD
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
    assert top.jacobian.shape[0] == 0
    closer = object_at((3.0, -1.4, 0))[np.newaxis]
    top, found = result(np.zeros(3), velocity, closer, braking(), velocity=velocity)
    assert top.jacobian.shape == (1, 3)
    assert found[1] > 0.0


@pytest.mark.parametrize(
    ("speed", "deep_m"), [(1.0, 1.5e-3), (2.0, 1.5e-3), (3.0, 1.5e-3), (4.0, 0.01)]
)
def test_a_vehicle_that_lags_behind_passes_beside_a_standing_object(
    speed: float, deep_m: float
) -> None:
    """Without a margin. Judged from where it is, it would enter by 4 mm at 3 m/s, and by 89 mm at 4 m/s."""
    wanted, near = np.array([speed, 0.0, 0.0]), ROCK
    for aside in (0.3, 0.6, 0.9, 1.2, 1.4):
        place, velocity, memory, least = np.array([-4.0, aside, 0.0]), wanted, empty_memory(), 9.0
        while place[0] < 1.0:
            top, told = result(place, wanted, near, braking(), memory=memory, velocity=velocity)
            memory = top.memory
            velocity = velocity + DT * (told - velocity) / LAG
            place = place + DT * velocity
            least = min(least, float(np.linalg.norm(place)) - KEEP_OUT)
        assert least > -deep_m


@given(
    seed=seeds,
    gain=st.floats(2.0, 20.0),
    attitude_s=st.floats(0.01, 0.2),
    fed_forward=st.sampled_from([0.0, 1.0]),
)
def test_a_vehicle_ends_on_the_line_of_its_drift_with_every_command(
    seed: int, gain: float, attitude_s: float, fed_forward: float
) -> None:
    """x' = v, v' = a, t a' = f u' + K (u - v) - a, u' = b (w - u) with a constant w."""
    velocity, acceleration, command, told = states = np.random.default_rng(seed).normal(size=(4, 3))
    config = braking(loop=VelocityLoop(gain, attitude_s, fed_forward))
    b, f = config.bandwidth, fed_forward
    rates = [
        [0.0, 1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0, 0.0],
        np.array([0.0, -gain, -1.0, gain - f * b, f * b]) / attitude_s,
        [0.0, 0.0, 0.0, -b, b],
        [0.0, 0.0, 0.0, 0.0, 0.0],
    ]
    place = (expm(20.0 * np.array(rates)) @ np.vstack([np.zeros(3), states]))[0]
    line = place - drift(velocity, command, acceleration, config)
    assert np.linalg.norm(np.cross(line, told)) < 1e-6 * np.linalg.norm(told)


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
            ObstacleView(
                near, 0.0, empty_memory(), DT, common, common, 0.0, NO_DRIFT, NOTHING_TOLD
            ),
            ObstacleView(
                near, 0.0, empty_memory(), DT, common, np.zeros(3), 0.0, NO_DRIFT, NOTHING_TOLD
            ),
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
    assert top.jacobian.shape[0] == 0
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
        object_at(place, there)[None],
        0.0,
        empty_memory(),
        DT,
        here,
        here + lag,
        0.0,
        NO_DRIFT,
        NOTHING_TOLD,
    )
    other = ObstacleView(
        object_at((0, 0, 0), here)[None],
        0.0,
        empty_memory(),
        DT,
        there,
        there - lag,
        0.0,
        NO_DRIFT,
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
    _, velocity = result(np.zeros(3), np.array([5.0, 5.0, 0]), np.empty((0, 8)), config, age=age)
    assert np.linalg.norm(velocity) == pytest.approx(
        braking_speed(4.0, 6.0, LATENCIES * (LAG + age))
    )
    off = config_of(AVOIDANCE_OFF)
    _, velocity = result(np.zeros(3), np.array([5.0, 5.0, 0]), np.empty((0, 8)), off, age=age)
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
