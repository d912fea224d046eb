"""The search for the worst flights, and the probability of rare ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep import search
from ptnsbc_sim.sweep.draws import Coordinates, SweepError, parse_axis, parse_starts
from ptnsbc_sim.sweep.plan import SweepPlan, draw, drawn_scenario, layout_of, plan_of
from ptnsbc_sim.sweep.rows import MARGINS, fly_draw
from ptnsbc_sim.sweep.search import Generations, Rare

DIMS = 12
BASE = load_scenario("paper_5_free", {"timing.duration_s": 0.5})


def answered(generations: Generations, margin: search.Evaluate) -> tuple[Array, Rare | None]:
    """All points of a search whose flights have this margin, and what it returns."""
    points = [next(generations)]
    while True:
        one = margin(points[-1])
        try:
            points.append(generations.send(np.stack([one] * len(MARGINS), axis=1)))
        except StopIteration as end:
            return np.concatenate(points), end.value


@pytest.mark.parametrize("probability", [0.2, 1e-2, 1e-4])
def test_the_probability_of_a_half_space_is_found(probability: float) -> None:
    # margin = b - a.z with |a| = 1: P(margin < 0) = Phi(-b)
    b, a = -ndtri(probability), np.full(DIMS, DIMS**-0.5)
    inside, reaches = 0, []
    for seed in range(20):
        _, found = answered(search.rare(DIMS, 1e-9, seed), lambda z: b - z @ a)
        assert found is not None
        inside += found.low <= probability <= found.high
        reaches.append(found.probability / probability)
    assert inside >= 17  # of 19 at 95 %
    assert 0.8 < np.exp(np.mean(np.log(reaches))) < 1.25


def test_what_is_rarer_than_asked_for_is_said_as_a_bound() -> None:
    _, found = answered(search.rare(DIMS, 1e-3, 0), lambda z: 9.0 - z[:, 0])
    assert found is not None
    assert (found.probability, found.low) == (0.0, 0.0)
    assert 1e-3 <= found.high < 5e-3


def test_the_search_finds_what_random_draws_do_not() -> None:
    # a ball of 2.5 sigma around a place that 1 of 40 million draws reaches
    centre = np.full(DIMS, 1.8)

    def margin(z: Array) -> Array:
        return np.linalg.norm(z - centre, axis=1) - 2.5

    points, _ = answered(search.worst(DIMS, 6000, 1), margin)
    assert margin(points).min() < -1.5
    assert np.abs(points).max() <= search.FARTHEST
    random = np.random.default_rng(1).standard_normal((6000, DIMS))
    assert margin(random).min() > 0.0


def test_the_coordinates_of_a_point_are_the_numbers_of_its_quantities() -> None:
    numbers = Coordinates((0.25, 0.5, 0.75, 0.0, 0.9, 0.1), 1)
    assert numbers.uniform(2.0, 4.0) == 2.5
    assert numbers.standard_normal(2) == pytest.approx(ndtri([0.5, 0.75]))
    assert numbers.integers(3) == 0
    assert numbers.permutation(2).tolist() == [1, 0]
    beyond = numbers.random(4)
    assert numbers.used == 10
    assert (beyond == Coordinates((), 1).random(4)).all()


def plan_near(runs: int = 3, **rest: Any) -> SweepPlan:
    return plan_of(BASE, runs, starts=parse_starts("near:0.2"), **rest)


def test_a_draw_is_a_point() -> None:
    plan = plan_near(axes=(parse_axis("timing.duration_s=0.5:1.5"),))
    layout = dict(layout_of(plan))
    assert layout == {"timing.duration_s": 1, "seed": 1, "starts": 15}
    starts = [1.0, 0, 0, 0, -2.0, *[0.0] * 10]
    place = {"timing.duration_s": [0.5], "seed": [0.0], "starts": starts}
    point = tuple(float(value) for name in layout for value in place[name])
    one = SweepPlan(
        **{**vars(plan), "points": (point,), "layout": tuple(layout.items()), "runs": 1}
    )
    scenario, values = drawn_scenario(SweepPlan.from_json(one.to_json()), 0)
    assert values["timing.duration_s"] == pytest.approx(0.5 + ndtr(0.5))
    moved = np.subtract(*([uav.position_m for uav in of.uavs] for of in (scenario, BASE)))
    assert moved[0] == pytest.approx([0.2, 0.0, 0.0])
    assert moved[1] == pytest.approx([0.0, -0.4, 0.0])
    assert draw(one, 0).uavs == scenario.uavs
    assert scenario.seed == 2**31


def test_a_flight_has_a_margin_for_each_promise() -> None:
    plan = plan_of(load_scenario("paper_5_free", {"timing.duration_s": 6.0}), 1)
    for row in fly_draw(plan, 0)[0]:
        keep_out_m = BASE.keep_out_m(row.uav)
        assert row.keep_out_margin == pytest.approx(row.closest_uav_m / keep_out_m - 1.0)
        assert row.in_place and row.return_margin is None
        assert row.deadline_margin == pytest.approx(1 - row.error_at_deadline_m / row.tolerance_m)


def test_a_search_goes_on_and_does_not_depend_on_its_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search, "_SPECIES", 2)
    plan = plan_near(75, stop_after_s=0.1)
    whole = search.search(plan, tmp_path / "a", workers=1)
    assert whole.margins.shape == (100, len(MARGINS))  # two generations
    kept = tmp_path / "a" / "margins.npy"
    np.save(kept, np.load(kept)[:50])  # as if it was ended after the first one
    again = search.search(plan, tmp_path / "a", workers=2)
    assert again.margins.tolist() == whole.margins.tolist()
    assert again.plan == whole.plan
    assert whole.so_far()[-1] == (100, whole.margins.min())
    margins = [min(search.fly_margins(whole.plan.to_json())[k]) for k in range(3)]
    assert margins == sorted(whole.margins.min(axis=1).tolist())[:3]
    with pytest.raises(SweepError, match="another search"):
        search.search(plan_near(75, stop_after_s=0.2), tmp_path / "a", workers=1)


def test_more_flights_go_on_with_a_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "_SPECIES", 2)
    first = search.search(plan_near(50, stop_after_s=0.1), tmp_path, workers=1)
    flown: list[str] = []
    fly = search.fly_margins
    monkeypatch.setattr(search, "fly_margins", lambda plan: flown.append(plan) or fly(plan))
    more = search.search(plan_near(100, stop_after_s=0.1), tmp_path, workers=1)
    assert (len(flown), len(more.margins)) == (2, 100)  # chunks of 25
    assert more.margins[:50].tolist() == first.margins.tolist()


def test_a_search_needs_something_to_vary(tmp_path: Path) -> None:
    grid = plan_near(axes=(parse_axis("timing.duration_s=0.3,0.4"),))
    with pytest.raises(SweepError, match="no list or grid"):
        search.search(grid, tmp_path)


def test_what_the_dry_runs_refuse_breaks_no_promise(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_near(1, stop_after_s=0.1)  # void: nothing is left of its margin
    assert search.fly_margins(plan.to_json()).min() < 0.0
    monkeypatch.setattr(search, "dry_run_says", lambda plan, k: search.REFUSED)
    checked = plan_near(1, stop_after_s=0.1, check=1)
    assert (search.fly_margins(checked.to_json()) == search.NO_MARGIN).all()


def test_what_is_refused_does_not_end_the_levels_of_a_rare_event() -> None:
    # of five flights one is refused, and of the others none breaks a promise
    def margin(z: Array) -> Array:
        return np.where(z[:, 0] > 0.85, search.NO_MARGIN, 9.0 - z[:, 1])

    _, found = answered(search.rare(DIMS, 1e-4, 0), margin)
    assert found is not None
    assert (found.probability, found.high) == (0.0, 1e-4)


def test_chains_that_cannot_move_end_and_exclude_little() -> None:
    # what is close to a broken promise has no neighbours: they are refused
    first = np.random.default_rng(0).standard_normal((search.LEVEL_FLIGHTS, DIMS))
    close = set(map(tuple, first[:: search.LEVEL_FLIGHTS // 100]))

    def margin(z: Array) -> Array:
        return np.array([0.1 if tuple(one) in close else search.NO_MARGIN for one in z])

    _, found = answered(search.rare(DIMS, 1e-9, 0), margin)
    assert found is not None and found.probability == 0.0
    assert found.high == pytest.approx(3.0 * 0.1 / 100)


def test_one_promise_is_searched_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "_SPECIES", 2)
    plan = plan_near(50, stop_after_s=0.1)
    found = search.search(plan, tmp_path, promise="keep_out_margin", workers=1)
    assert found.margins.shape == (50, 1)
    distances = [min(row.keep_out_margin for row in fly_draw(found.plan, k)[0]) for k in range(3)]
    assert distances == sorted(found.margins[:, 0].tolist())[:3]
    with pytest.raises(SweepError, match="another search"):
        search.search(plan, tmp_path, workers=1)
