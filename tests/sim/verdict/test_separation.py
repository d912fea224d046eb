"""Distances between UAVs and to obstacles, and keep-outs that were entered."""

from collections.abc import Callable

import numpy as np
import pytest
from synthetic_flights import verdict_of

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.verdict import Recording, verdict_on
from ptnsbc_tools.tables import verdict_sentence

Fly = Callable[..., Recording]


def test_separation_names_the_pair_and_the_time(fly: Fly) -> None:
    """UAV 3 and 4 are 1.2 m apart; 0.8 m east for one second leaves 0.4 m."""
    verdict = verdict_on(fly({3: lambda t: np.where((t >= 7) & (t < 8), 0.8, 0.0)}))
    worst = verdict.separations[0]
    assert (worst.first, worst.second) == ("uav3", "uav4")
    assert worst.distance_m == pytest.approx(0.4)
    assert 7.0 <= worst.at_s < 8.0
    assert worst.inside_s == pytest.approx(1.0)
    assert verdict.inside_keep_out_s == pytest.approx(1.0)


def test_a_keep_out_that_was_entered_is_violated(fly: Fly) -> None:
    verdict = verdict_on(fly({3: lambda t: np.where((t >= 2) & (t < 3), 0.8, 0.0)}))
    assert (verdict.verdict, verdict.exit_code) == ("violated", 1)
    assert [one.verdict for one in verdict.uavs] == ["met", "met", "violated", "violated", "met"]
    text = "0.400 m from uav4 at 2.00 s, inside the keep-out of 0.5 m for 1.00 s"
    assert verdict_of(verdict, 3).reason == text
    assert "Inside keep-outs for 1.00 s." in str(verdict_sentence(verdict))


def test_a_violated_uav_that_is_late_says_both(fly: Fly) -> None:
    one = verdict_of(verdict_on(fly({3: lambda t: np.where((t >= 2) & (t < 6), 0.8, 0.0)})), 3)
    assert one.verdict == "violated"
    assert one.reason.endswith("for 4.00 s, settled after 6.00 s")


@pytest.mark.parametrize(("beyond", "kind"), [(0.0, "met"), (1e-12, "violated")])
def test_a_distance_is_compared_with_its_keep_out_as_it_is(
    fly: Fly, beyond: float, kind: str
) -> None:
    """UAV 3 and 4 are 1.2 m apart: a distance that equals the keep-out is kept."""
    free = fly()
    leader, other = (free.odometry[uav].values[:, :3] for uav in (3, 4))
    keep_out = float(np.min(np.linalg.norm(leader - other, axis=1))) + beyond
    changes = {"timing.duration_s": 12.0, "formation.uav_keep_out_m": keep_out}
    scenario = load_scenario("paper_5_free", changes)
    assert verdict_on(fly(scenario=scenario)).verdict == kind


@pytest.mark.parametrize(("beyond", "kind"), [(1e-9, "met"), (-1e-9, "violated")])
def test_a_uav_above_another_one_keeps_the_height_of_its_keep_out(
    fly: Fly, beyond: float, kind: str
) -> None:
    """The distance is told as that of two side by side."""
    above = load_scenario(
        "paper_5_free",
        {
            "timing.duration_s": 12.0,
            "formation.offsets_m.4": [0.0, 0.0, 1.2],
            "formation.uav_keep_out_m": 0.5,
            "formation.uav_keep_out_above_m": 1.2 - beyond,
        },
    )
    verdict = verdict_on(fly(scenario=above))
    assert verdict.verdict == kind
    nearest = verdict.separations[0]
    assert (nearest.first, nearest.second, nearest.keep_out_m) == ("uav1", "uav4", 0.5)
    assert nearest.distance_m == pytest.approx(0.5)


def test_a_keep_out_entered_at_the_last_instant_counts(fly: Fly) -> None:
    verdict = verdict_on(fly({3: lambda t: np.where(t > 11.985, 0.8, 0.0)}))
    assert (verdict.verdict, verdict.inside_keep_out_s) == ("violated", 0.0)


def test_an_obstacle_is_a_keep_out_too(fly: Fly) -> None:
    block = {"name": "O9", "position_m": [0.0, 0.0, 3.0], "keep_out_m": 1.0}
    scenario = load_scenario("paper_5_free", {"timing.duration_s": 12.0})
    spot = fly().odometry[2].values[700, :3]
    block["position_m"] = spot.tolist()
    changes = {"timing.duration_s": 12.0, "world.obstacles": [block]}
    scenario = load_scenario("paper_5_free", changes)
    verdict = verdict_on(fly(scenario=scenario))
    assert verdict_of(verdict, 2).verdict == "violated"
    assert verdict_of(verdict, 2).reason.startswith("0.000 m from O9 at 7.00 s")


def test_obstacles_are_named(fly: Fly) -> None:
    names = {one.second for one in verdict_on(fly(scenario=load_scenario("paper_5"))).separations}
    assert {"O1", "O2"} <= names
