"""A flight judged in small blocks has the verdict of one judged at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.verdict import track, verdict, verdict_on

SUMS = ("rmse", "energy", "encounter_s", "inside")
LEGS = ((0, "form"), (9 * 10**9, "form"), (17 * 10**9, "hold"))


def test_samples_at_other_times() -> None:
    stamps = np.arange(0, 1000, 10, dtype=np.int64) + 1_700_000_000_000_000_000
    series = track.Track(stamps, np.random.default_rng(1).normal(size=(100, 5)))
    some = np.array([3, 4, 50, 99])
    np.testing.assert_array_equal(series.at(stamps[some]), series.values[some])
    np.testing.assert_array_equal(series.at(stamps[some], 3), series.values[some, :3])
    between = series.at(stamps[:-1] + 5, 2)
    np.testing.assert_allclose(between, 0.5 * (series.values[1:, :2] + series.values[:-1, :2]))
    beyond = series.at(stamps[[0, -1]] + np.array([-1, 7]))
    np.testing.assert_array_equal(beyond, series.values[[0, -1]])


def in_blocks(recording: Any, rows: int) -> dict[str, Any]:
    with pytest.MonkeyPatch.context() as patch:
        for module in (track, verdict):
            patch.setattr(module, "BLOCK", rows)
        return verdict_on(recording).as_json()


def flat(value: Any, where: str = "") -> dict[str, Any]:
    """Every number and word by its path."""
    if isinstance(value, dict):
        return {k: v for key, one in value.items() for k, v in flat(one, f"{where}.{key}").items()}
    if isinstance(value, list | tuple):
        return {k: v for i, one in enumerate(value) for k, v in flat(one, f"{where}.{i}").items()}
    return {where: value}


def flights(fly, count, without) -> dict[str, Any]:
    busy = count(20.0, lambda t: np.clip(t - 4.0, 0.0, 3.0) + np.clip(t - 14.0, 0.0, 1.0))
    noise = np.random.default_rng(2)
    moving = {uav: lambda t: 0.02 * noise.standard_normal(t.size) for uav in (1, 2, 4)}
    moving[3] = lambda t: np.where((t > 7) & (t < 8), 0.8, np.exp(-t))
    with_obstacles = fly(moving, seconds=20.0, epochs=LEGS)
    wild = fly(moving, seconds=20.0, scenario=load_scenario("paper_5"), epochs=LEGS[:1])
    for series in wild.wrench.values():
        series.values[:] += noise.standard_normal(series.values.shape)
    wild.odometry[4].values[1700:, 1] = np.nan
    wild.wrench[2].values[900:905, 0] = np.nan
    wild.estimate.update(wild.odometry)
    holes = fly(moving, seconds=20.0)
    for of in (holes.odometry, holes.wrench):
        of[2] = without(of[2], *range(600, 660), *range(900, 903), 1999)
    with_obstacles.counters[4] = busy
    wild.counters[1] = busy
    return {"legs": with_obstacles, "wild": wild, "holes": holes}


@pytest.mark.parametrize("rows", [7, 500, 501])
def test_the_size_of_a_block_changes_nothing(fly, count, without, rows):
    for name, recording in flights(fly, count, without).items():
        whole, pieces = flat(in_blocks(recording, 10**6)), flat(in_blocks(recording, rows))
        # Sums are taken in another order; nothing else may differ by a bit.
        sums = {key for key in whole if key.rpartition(".")[2].startswith(SUMS) and whole[key]}
        assert len(sums) > 10
        for key in sums:
            assert pieces.pop(key) == pytest.approx(whole.pop(key), rel=1e-12), (name, key)
        assert pieces == whole, name
