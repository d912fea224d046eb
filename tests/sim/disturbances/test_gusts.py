"""Gusts: deviation, correlation time and mean as asked for, from the first tick on."""

import numpy as np
import pytest

from ptnsbc_sim.disturbances.gusts import gust_step, gusts

DT, TIME = 0.01, 2.0


def wind(ticks: int, seed: int = 1) -> np.ndarray:
    kind = gusts(np.array([1.6, 1.2, 0.0]), np.array([0.7, 0.7, 0.0]), TIME, DT)
    draws = np.random.default_rng(seed).standard_normal((ticks, 3))
    gust, out = np.zeros(3), np.empty((ticks, 3))
    for tick in range(ticks):
        gust_step(gust, out[tick], draws[tick], tick, kind)
    return out


def test_mean_deviation_and_correlation() -> None:
    found = wind(200_000)
    np.testing.assert_allclose(found.mean(axis=0), [1.6, 1.2, 0.0], atol=0.15)
    np.testing.assert_allclose(found.std(axis=0), [0.7, 0.7, 0.0], rtol=0.1)
    off = found[:, 0] - found[:, 0].mean()
    later = round(TIME / DT)
    assert np.mean(off[later:] * off[:-later]) / off.var() == pytest.approx(np.exp(-1), abs=0.1)


def test_stationary_from_the_first_tick() -> None:
    first = np.array([wind(1, seed)[0, 0] for seed in range(400)])
    assert first.std() == pytest.approx(0.7, rel=0.15)


def test_none_is_the_mean_to_the_last_bit() -> None:
    mean = np.array([2.0, -0.3, 0.1])
    out = np.empty(3)
    gust_step(np.zeros(3), out, np.ones(3), 0, gusts(mean, np.zeros(3), TIME, DT))
    assert out.tobytes() == mean.tobytes()
