"""The reducers of a verdict beside their plain definitions, on random flights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from synthetic_flights import away

from ptnsbc_core.types import Array
from ptnsbc_sim.verdict import Recording, Track, verdict_on
from ptnsbc_sim.verdict.encounters import Encounter
from ptnsbc_sim.verdict.error_figures import ErrorFigures, add_errors
from ptnsbc_sim.verdict.formation_error import formation_errors
from ptnsbc_sim.verdict.separation import separations
from ptnsbc_sim.verdict.track import Together

SECOND_NS, DEADLINE_S, TOLERANCE_M = 10**9, 5.0, 0.05


def wild(fly: Callable[..., Recording], count: Callable[..., Any], rng: Any) -> Recording:
    """Five UAVs that come and stray, push at random, and avoid now and then."""

    def straying() -> Callable[[Array], Array]:
        stray, noise = away(*sorted(rng.uniform(0.0, 12.0, 2))), 0.02 * rng.standard_normal(1200)
        return lambda t: stray(t) + noise

    recording = fly({uav: straying() for uav in rng.permutation(5)[:3] + 1})
    for track in recording.wrench.values():
        track.values[:] += rng.standard_normal(track.values.shape)
    busy = {uav: count(12.0, lambda t: np.clip(t - rng.uniform(0, 9), 0, 2)) for uav in range(1, 6)}
    return replace(recording, counters=busy, estimate=recording.odometry)


def as_one(tracks: Any) -> Together:
    values = np.stack([track.values for track in tracks.values()], axis=1)
    return Together(tuple(tracks), Track(tracks[1].t_ns, values))


@pytest.mark.parametrize("seed", range(3))
def test_uavs_that_are_reduced_together_have_the_figures_of_each_alone(fly, count, seed) -> None:
    recording = wild(fly, count, np.random.default_rng(seed))
    names = ("odometry", "wrench", "counters", "estimate")
    joint = replace(recording, **{name: as_one(getattr(recording, name)) for name in names})
    assert verdict_on(joint).as_json() == verdict_on(recording).as_json()


def last(mask: list[bool], times: list[float], beyond: Any) -> Any:
    """The time after the last True, `beyond` when that is the last of all, 0 without one."""
    numbers = [k for k, there in enumerate(mask) if there]
    return 0.0 if not numbers else [*times, beyond][numbers[-1] + 1]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("rows", [1200, 77])
def test_the_figures_of_an_error_are_what_they_are_called(fly, count, seed, rows) -> None:
    rng = np.random.default_rng(seed)
    recording = wild(fly, count, rng)
    whole = next(iter(recording.blocks()))
    errors = formation_errors(recording, whole)
    figures = []
    for uav in recording.scenario.uav_ids:
        edges = np.sort(rng.uniform(0.0, 12.0, 2 * 3)).reshape(2, 3) * SECOND_NS
        windows = [Encounter(*map(int, of)) for of in edges]
        figures.append(ErrorFigures(recording, uav, windows, TOLERANCE_M))
    for first in range(0, whole.stamps.size, rows):
        span = slice(first, first + rows)
        block = whole._replace(stamps=whole.stamps[span], times=whole.times[span])
        add_errors(figures, block, errors[:, span])
    for figure, row in zip(figures, errors.tolist(), strict=True):
        check_figures(figure, whole.times.tolist(), whole.stamps.tolist(), row)


def check_figures(figure: ErrorFigures, t: list[float], t_ns: list[int], e: list[float]) -> None:
    band = max(TOLERANCE_M, 0.02 * e[0])
    outside = [error > band for error in e]
    after = [time >= DEADLINE_S - 1e-9 for time in t]
    late = [w for w in figure.windows if w.begin_ns > DEADLINE_S * SECOND_NS]
    near, later = (
        [any(w.begin_ns <= stamp <= w.back_ns for w in windows) for stamp in t_ns]
        for windows in (figure.windows, late)
    )
    ticks = range(len(t))
    assert figure.settling_s == last([outside[k] and not later[k] for k in ticks], t, None)
    kept = [e[k] for k in ticks if after[k] and not near[k]]
    assert figure.max_after_all == max(e[k] for k in ticks if after[k])
    assert figure.max_after == max(kept)
    assert figure.rmse_after == pytest.approx((sum(of**2 for of in kept) / len(kept)) ** 0.5)
    periods = [0.0, *np.diff(t)]
    assert figure.encounter_s == pytest.approx(sum(periods[k] for k in ticks if near[k]))
    excused = [k for k in ticks if near[k] and after[k] and outside[k]]
    assert figure.excused_outside_s == pytest.approx(sum(periods[k] for k in excused))
    assert figure.at_deadline == np.interp(DEADLINE_S, t, e)
    for regain in figure.regains:
        until_s = regain.over_s + regain.promised_s + 1e-9
        there = [k for k in ticks if outside[k] and regain.over_s <= t[k] <= until_s]
        assert regain.outside_s == (t[there[-1]] if there else None)


def test_the_closest_approach_is_the_least_distance_of_each_pair(fly, count) -> None:
    recording = wild(fly, count, np.random.default_rng(3))
    block = next(iter(recording.blocks()))
    found = {(pair.first, pair.second): pair for pair in separations(recording, block)}
    assert list(found) == [(f"uav{a}", f"uav{b}") for a, b in combinations(range(1, 6), 2)]
    for (first, second), pair in found.items():
        places: list[Array] = [recording.odometry[int(name[3:])].values for name in (first, second)]
        apart = np.linalg.norm(places[0][:, :3] - places[1][:, :3], axis=1)
        assert (pair.distance_m, pair.at_s) == (apart.min(), block.times[np.argmin(apart)])
        assert pair.inside_s == pytest.approx(0.01 * np.sum(apart[:-1] < pair.keep_out_m), abs=1e-9)
