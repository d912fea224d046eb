"""Obstacle memory: an object is recognised by position, forgotten when quiet, and passed on the other side in time."""

import numpy as np
import pytest

from ptnsbc_core.tasks.obstacle_memory import (
    QUIET_S,
    SIDE,
    SLOTS,
    USED,
    active_time,
    empty_memory,
    find_slot,
    side_of,
    update,
)
from ptnsbc_core.types import PROFILE_PAPER, SPEED_LINEAR, ClearanceConfig, LoopGain

DT = 0.1
GAIN = LoopGain(1.0, 1e-2, 1.0, 3.0, PROFILE_PAPER)
CONFIG = ClearanceConfig(
    1, 0.0, GAIN, 0.6, 0.5, 2.05, 1.0, SPEED_LINEAR, 6.0, 6.0, 0.2, 5.0, 0.05, 0.5, 4.0, 4.0, 0.1
)


def near_of(*centres: tuple[float, float, float]) -> np.ndarray:
    rows = np.zeros((len(centres), 7))
    rows[:, 0:3] = centres
    rows[:, 3] = 1.5
    return rows


def met(memory: np.ndarray, near: np.ndarray, ticks: int = 1, side: float = 1.0, hit: float = 1.0):
    count = near.shape[0]
    for _ in range(ticks):
        memory = update(memory, near, np.full(count, hit), np.full(count, side), DT, CONFIG)
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
    assert active_time(memory, np.array([7.0, 0, 0])) == pytest.approx(15 * DT)


def test_an_encounter_ends_when_it_has_been_quiet() -> None:
    memory = met(empty_memory(), near_of((0, 0, 0)), ticks=5)
    for _ in range(9):
        memory = met(memory, near_of((0, 0, 0)), hit=0.0)
    assert active_time(memory, np.zeros(3)) == pytest.approx(5 * DT)
    assert memory[0, QUIET_S] == pytest.approx(0.9)
    memory = met(memory, near_of((0, 0, 0)), ticks=2, hit=0.0)
    assert memory[:, USED].sum() == 0
    assert active_time(memory, np.zeros(3)) == 0.0
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
        memory = update(memory, near_of((3.0 * k, 0, 0)), np.ones(1), np.ones(1), 0.01, CONFIG)
    assert memory[:, USED].sum() == SLOTS
    memory = update(memory, near_of((0, 50, 0)), np.ones(1), np.ones(1), 0.01, CONFIG)
    assert memory[:, USED].sum() == SLOTS
    assert find_slot(memory, np.array([0.0, 50, 0])) == 0
    assert find_slot(memory, np.zeros(3)) == -1


def test_the_memory_given_is_left_alone() -> None:
    memory = met(empty_memory(), near_of((0, 0, 0)))
    before = memory.copy()
    met(memory, near_of((0, 0, 0), (4, 4, 4)), ticks=3)
    np.testing.assert_array_equal(memory, before)
