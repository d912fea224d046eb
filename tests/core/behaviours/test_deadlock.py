"""Deadlocks: found after the stated time and no earlier, left at a speed of each UAV's own, told in the verdict."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.agent import DEADLOCK
from ptnsbc_core.behaviours.contract import FormationPlace
from ptnsbc_core.behaviours.deadlock import (
    NEAR_ZERO,
    WANTED,
    in_deadlock,
    standing_time,
    stands_still,
    way_out,
)
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.headless import recording_of

stands_still, way_out = on_arrays(stands_still), on_arrays(way_out)

DT = 0.01
SCENARIO = load_scenario("paper_5")
CONFIGS = [agent_config(SCENARIO, uav).clearance for uav in SCENARIO.uav_ids]
CONFIG = CONFIGS[0]
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
        standing = standing_time(standing, tick < 1000, DT, CONFIG)
        if in_deadlock(standing, CONFIG) and began is None:
            began = (tick + 1) * DT
        if began is not None and ended is None and not in_deadlock(standing, CONFIG):
            ended = (tick + 1) * DT - 10.0
    assert began == pytest.approx(CONFIG.deadlock_s, abs=2 * DT)
    assert ended == pytest.approx(0.25 * CONFIG.deadlock_s, abs=2 * DT)
    assert standing == 0.0


@given(seed=seeds)
def test_without_a_deadlock_not_a_bit_changes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    velocity, place = rng.normal(size=3), FormationPlace(rng.normal(size=3), rng.normal(size=3))
    free = way_out(velocity, place, rng.uniform(0.0, CONFIG.deadlock_s), CONFIG)
    np.testing.assert_array_equal(free, velocity)


def test_any_two_are_a_keep_out_apart_after_another_such_time() -> None:
    """In height, when they climb as fast as they ask; nobody climbs above its layer."""
    keep_out, heights = SCENARIO.formation.uav_keep_out_m, np.zeros(len(CONFIGS))
    for tick in range(3000):
        for row, config in enumerate(CONFIGS):
            place = FormationPlace(np.array([5.0, 0.0, -heights[row]]), np.zeros(3))
            heights[row] += DT * way_out(np.zeros(3), place, config.deadlock_s, config)[2]
        if tick == 2 * round(CONFIG.deadlock_s / DT):
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
