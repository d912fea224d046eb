"""Errors of the stand-in's estimate."""

import numpy as np
import pytest

from ptnsbc_autopilot.physics.airframe import ERROR_POSITION, ERROR_VELOCITY
from ptnsbc_autopilot.physics.navigation import QUALITIES, UPDATE_HZ, Navigation

FLIGHT_S = 40


def flown(quality, seed, seconds=FLIGHT_S):
    made = Navigation(QUALITIES[quality], np.zeros(3), 0.0, seed)
    before = made.errors.copy()
    for _ in range(seconds * UPDATE_HZ):
        made.update(1.0 / UPDATE_HZ, False)
    return made.errors - before


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_after_landing_the_height_is_off_by_decimetres():
    """Measured: 0.2 to 0.5 m."""
    assert 0.2 < rms([flown("plain", seed)[2] for seed in range(60)]) < 0.5


def test_rtk_knows_its_place_to_centimetres():
    assert rms([flown("rtk", seed)[:2] for seed in range(30)]) == pytest.approx(0.02, abs=0.01)


def test_perfect_knows_its_place():
    assert not flown("perfect", 1).any()


def test_at_boot_the_local_position_is_zero():
    start = np.array((3.0, 4.0, 0.0))
    made = Navigation(QUALITIES["plain"], start, 0.0, 7)
    assert start + made.errors[ERROR_POSITION] == pytest.approx([0, 0, 0], abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_origin_lies_within_its_spread(seed):
    made = Navigation(QUALITIES["perfect"], np.zeros(3), 30.0, seed)
    assert 0.0 < np.hypot(*made.origin_enu[:2]) <= 30.0
    assert made.origin_enu[2] == 0.0


def test_without_satellites_the_position_runs_away():
    made = Navigation(QUALITIES["rtk"], np.zeros(3), 0.0, 2)
    made.lose(0.0)
    for _ in range(30 * UPDATE_HZ):
        made.update(1.0 / UPDATE_HZ, False)
    assert np.linalg.norm(made.errors[ERROR_POSITION]) > 2.0
    assert made.errors[ERROR_VELOCITY][2] == 0.0
    assert (made.fix_type, made.lost_s(4.0)) == (1, 4.0)
