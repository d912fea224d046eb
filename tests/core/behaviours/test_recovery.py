"""The way back after an encounter: bumpless, over after T, armed anew. Deadlocks: found in time, left, told."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.agent import DEADLOCK
from ptnsbc_core.behaviours.recovery import (
    DISTURBED,
    NEAR_ZERO,
    UNDISTURBED,
    WANTED,
    armed,
    in_deadlock,
    recovery_duration,
    standing_time,
    stands_still,
    way_back,
    way_out,
)
from ptnsbc_core.timebase import Clock
from ptnsbc_core.types import FormationPlace, RecoveryConfig
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.recording import recording_of

KAPPA, DT = 2.2, 0.01
CONFIG = RecoveryConfig(1.0, 6.0, 2.5)

metres = st.floats(-5.0, 5.0)
speeds = st.floats(-3.0, 3.0)
vectors = st.tuples(metres, metres, metres)
velocities = st.tuples(speeds, speeds, speeds)


def at(recovery, s: float, dt: float = DT):
    return way_back(recovery, Clock(recovery.t + s, 0.0, dt), KAPPA)


@given(vectors, velocities)
def test_it_begins_with_the_deviation_and_the_velocity_of_the_uav(x, u) -> None:
    recovery = armed(x, u, 7.0, KAPPA, CONFIG)
    first = at(recovery, 0.0, 1e-5)
    np.testing.assert_allclose(first.deviation, x, atol=1e-9)
    np.testing.assert_allclose(first.velocity, u, atol=1e-3)
    assert first.progress == 0.0


@given(vectors, velocities)
def test_nothing_is_left_of_it_after_its_duration(x, u) -> None:
    """Predefined: T is known when it is armed, and P and P_dot vanish there."""
    recovery = armed(x, u, 7.0, KAPPA, CONFIG)
    end = at(recovery, recovery.duration_s)
    assert end == at(UNDISTURBED, 0.0)
    before = at(recovery, recovery.duration_s - DT)
    scale = np.linalg.norm(x) + np.linalg.norm(u)
    assert np.linalg.norm(before.deviation) <= 1e-4 * scale
    assert np.linalg.norm(before.velocity) <= 2e-2 * scale


@given(vectors)
def test_from_rest_it_asks_for_no_more_than_its_limits(x) -> None:
    recovery = armed(x, (0.0, 0.0, 0.0), 0.0, KAPPA, CONFIG)
    ticks = [at(recovery, s) for s in np.arange(0.0, recovery.duration_s, DT)]
    assert max(np.linalg.norm(one.velocity) for one in ticks) <= CONFIG.speed * 1.001
    assert max(np.linalg.norm(one.acceleration) for one in ticks) <= CONFIG.acceleration * 1.001


def test_who_comes_back_by_the_feedback_already_goes_on_so() -> None:
    """u = kappa x is the velocity of the feedback: A is 0, and P never is above x e^(-kappa s)."""
    x = np.array([1.0, -2.0, 0.5])
    recovery = armed(tuple(x), tuple(KAPPA * x), 0.0, KAPPA, CONFIG)
    np.testing.assert_allclose(recovery.rest, 0.0, atol=1e-12)
    for s in (0.3, 0.9, 1.8):
        left = np.linalg.norm(at(recovery, s).deviation)
        assert left <= np.linalg.norm(x) * np.exp(-KAPPA * s)


def test_duration_is_a_closed_form_of_the_distance() -> None:
    """sqrt(7.513 d / a) for short ways, 2.1875 d / v for long ones, and never less than the least."""
    assert recovery_duration(0.0, CONFIG) == 1.0
    assert recovery_duration(2.0, CONFIG) == pytest.approx(np.sqrt(7.513 * 2.0 / 2.5))
    assert recovery_duration(40.0, CONFIG) == pytest.approx(2.1875 * 40.0 / 6.0)


@pytest.mark.parametrize("recovery", [UNDISTURBED, DISTURBED])
def test_without_a_way_back_nothing_is_added(recovery) -> None:
    zero = (0.0, 0.0, 0.0)
    assert tuple(way_back(recovery, Clock(3.0, 3.0, DT), KAPPA)) == (zero, zero, zero, 1.0)


stands_still, way_out = on_arrays(stands_still), on_arrays(way_out)

SCENARIO = load_scenario("paper_5")
FLEET = [agent_config(SCENARIO, uav).clearance for uav in SCENARIO.uav_ids]
AVOIDANCE = FLEET[0]
seeds = st.integers(0, 2**31)


@given(seed=seeds, wanted=st.floats(0.0, 3.0), left=st.floats(-1.0, 3.0))
def test_it_is_the_speed_towards_the_place_beside_the_place_that_counts(
    seed: int, wanted: float, left: float
) -> None:
    rng = np.random.default_rng(seed)
    towards, across, moving = rng.normal(size=(3, 3))
    towards /= np.linalg.norm(towards)
    across -= across @ towards * towards
    place = FormationPlace(rng.uniform(0.1, 9.0) * towards, moving)
    found = stands_still(moving + wanted * towards, moving + left * towards + across, place)
    if min(abs(wanted - WANTED), abs(left - NEAR_ZERO)) > 1e-9:
        assert found == (wanted > WANTED and left < NEAR_ZERO)


def test_who_is_in_its_place_does_not_stand_still() -> None:
    assert not stands_still(np.ones(3), np.zeros(3), FormationPlace(np.zeros(3), np.zeros(3)))


def test_a_deadlock_begins_after_the_stated_time_and_ends_with_progress() -> None:
    standing, began, ended = 0.0, None, None
    for tick in range(2000):
        standing = standing_time(standing, tick < 1000, DT, AVOIDANCE)
        if in_deadlock(standing, AVOIDANCE) and began is None:
            began = (tick + 1) * DT
        if began is not None and ended is None and not in_deadlock(standing, AVOIDANCE):
            ended = (tick + 1) * DT - 10.0
    assert began == pytest.approx(AVOIDANCE.deadlock_s, abs=2 * DT)
    assert ended == pytest.approx(0.25 * AVOIDANCE.deadlock_s, abs=2 * DT)
    assert standing == 0.0


@given(seed=seeds)
def test_without_a_deadlock_not_a_bit_changes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    velocity, place = rng.normal(size=3), FormationPlace(rng.normal(size=3), rng.normal(size=3))
    free = way_out(velocity, place, rng.uniform(0.0, AVOIDANCE.deadlock_s), AVOIDANCE)
    np.testing.assert_array_equal(free, velocity)


def test_any_two_are_a_keep_out_apart_after_another_such_time() -> None:
    """In height, when they climb as fast as they ask; nobody climbs above its layer."""
    keep_out, heights = SCENARIO.formation.uav_keep_out_m, np.zeros(len(FLEET))
    for tick in range(3000):
        for row, config in enumerate(FLEET):
            place = FormationPlace(np.array([5.0, 0.0, -heights[row]]), np.zeros(3))
            heights[row] += DT * way_out(np.zeros(3), place, config.deadlock_s, config)[2]
        if tick == 2 * round(AVOIDANCE.deadlock_s / DT):
            assert np.diff(heights).min() > 0.75 * keep_out
    np.testing.assert_allclose(heights, keep_out * np.arange(1, 6), atol=0.01)


def test_a_uav_without_any_way_says_so() -> None:
    """Its place is behind a plane that has no end: it is told in the verdict, and the other UAVs are met."""
    wall = {"name": "wall", "kind": "plane", "position_m": [-2.5, 0, 0], "normal": [1, 0, 0]}
    keys = {"leader.trajectory": {"kind": "line", "position_m": [0, 0, 5]}, "timing.duration_s": 16}
    keys |= {"formation.offsets_m[5]": [-4, 0, 0], "formation.task": "relative_position"}
    keys |= {"uavs[4].position_m": [-1, 0.2, 5], "world.obstacles": [{**wall, "keep_out_m": 0.5}]}
    flight = fly(load_scenario("paper_5_free", keys))
    found = {one.uav: one for one in verdict_on(recording_of(flight)).uavs}
    assert "in a deadlock for" in found[5].reason
    assert found[5].verdict == "missed"
    told = flight.track.diagnostics[:, :, DEADLOCK].any(axis=0)
    assert told.tolist() == [False] * 4 + [True]
    assert np.isfinite(flight.truth).all()
    above = flight.truth[-1, 4, 2] - 5.0
    assert above < 5 * SCENARIO.formation.uav_keep_out_m + 0.1
