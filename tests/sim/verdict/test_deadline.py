"""Deadlines, their causes of a miss, and the changes of a shape that are due later."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from synthetic_flights import away, decay, verdict_of

from ptnsbc_sim.counters import COUNTERS
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.constants import places_beside_leader
from ptnsbc_sim.verdict import Recording, verdict_on

Fly = Callable[..., Recording]
SWAY = away(8.0, 8.5)


def test_settling_of_an_exponential(fly: Fly) -> None:
    """2 exp(-t) is last above 0.05 at t = ln 40 = 3.689 s: settled at the next sample, 3.69 s."""
    one = verdict_of(verdict_on(fly({3: decay(-2.0, 1.0)})), 3)
    assert one.verdict == "met"
    assert one.settling_s == pytest.approx(3.69)
    assert one.start_error_m == pytest.approx(2.0)
    assert one.error_at_deadline_m == pytest.approx(2 * np.exp(-5))
    assert one.residual == pytest.approx(np.exp(-5))
    assert one.max_error_after_m == pytest.approx(2 * np.exp(-5))


def test_a_large_start_widens_the_band_to_two_percent(fly: Fly) -> None:
    one = verdict_of(verdict_on(fly({3: decay(10.0, 2.0)})), 3)
    assert one.band_m == pytest.approx(0.2)
    assert one.settling_s == pytest.approx(np.log(50) / 2, abs=0.01)


def test_late_is_missed(fly: Fly) -> None:
    verdict = verdict_on(fly({4: decay(2.0, 0.5)}))
    one = verdict_of(verdict, 4)
    assert (one.verdict, verdict.verdict, verdict.exit_code) == ("missed", "missed", 1)
    assert one.reason == "settled after 7.38 s"
    assert verdict_of(verdict, 5).verdict == "met"


def test_inside_the_band_but_above_the_limit_is_missed(fly: Fly) -> None:
    one = verdict_of(verdict_on(fly({3: lambda t: np.where(t < 1, 8.0, 0.1)})), 3)
    assert one.band_m == pytest.approx(0.16)
    assert one.settling_s == pytest.approx(1.0)
    assert (one.verdict, one.reason) == ("missed", "error at the deadline above 0.05 m")


def test_tolerance_is_an_option(fly: Fly) -> None:
    recording = fly({3: lambda t: np.full_like(t, 0.08)})
    assert verdict_on(recording).verdict == "missed"
    assert verdict_on(recording, tolerance=0.1).verdict == "met"


def test_tolerance_is_the_scenarios(fly: Fly) -> None:
    changes = {"timing.duration_s": 12.0, "formation.tolerance_m": 0.1}
    patient = load_scenario("paper_5_free", changes)
    recording = fly({3: lambda t: np.full_like(t, 0.08)}, scenario=patient)
    assert verdict_on(recording).verdict == "met"
    assert verdict_of(verdict_on(recording), 3).tolerance_m == 0.1
    assert verdict_on(recording, tolerance=0.05).verdict == "missed"


def test_an_error_after_the_deadline_is_missed(fly: Fly) -> None:
    one = verdict_of(verdict_on(fly({4: SWAY})), 4)
    assert one.verdict == "missed"
    assert one.reason == "met at the deadline, but outside 0.050 m again until 8.50 s"


def test_only_what_came_before_the_exit_voids_it(fly: Fly, count: Callable[..., Any]) -> None:
    def held(since: int) -> dict[int, Any]:
        counters = count(12.0, holding_s=0.7)
        counters.values[:since, COUNTERS.index("holding_s")] = 0.0
        return {4: counters}

    assert verdict_of(verdict_on(fly({4: SWAY}, counters=held(5))), 4).verdict == "missed"
    assert verdict_of(verdict_on(fly({4: SWAY}, counters=held(38))), 4).verdict == "void"
    assert verdict_of(verdict_on(fly({4: SWAY}, counters=held(50))), 4).verdict == "missed"


LIMIT = "at a limit of speed, acceleration or thrust for 0.70 s"


@pytest.mark.parametrize(
    ("name", "loss", "reason", "kind"),
    [
        ("saturated_s", 0.0, LIMIT, "missed"),  # the plan asked for it, or the loop is unstable
        ("holding_s", 0.0, "held for 0.70 s, link stale", "void"),
        ("holding_s", 0.1, "held for 0.70 s, link stale", "missed"),  # the scenario said so
    ],
)
def test_only_what_the_uavs_could_not_help_voids_a_miss(
    fly: Fly, count: Callable[..., Any], name: str, loss: float, reason: str, kind: str
) -> None:
    changes = {"timing.duration_s": 12.0, "communication.loss": loss}
    others = {4: count(12.0, **{name: 0.7})}
    others[4].values[:3, COUNTERS.index(name)] = 0.0
    late = fly(
        {4: decay(2.0, 0.5)}, counters=others, scenario=load_scenario("paper_5_free", changes)
    )
    verdict = verdict_on(late)
    assert verdict_of(verdict, 4).verdict == kind
    assert verdict_of(verdict, 4).reason.endswith(reason)
    assert verdict.exit_code == 1


@pytest.mark.parametrize(("dead", "kind"), [(4, "void"), (1, "void"), (5, "missed")])
def test_a_lost_process_voids_its_own_miss_and_those_that_depend_on_it(
    fly: Fly, count: Callable[..., Any], dead: int, kind: str
) -> None:
    """Whatever messages the scenario loses; UAV 4 does not depend on UAV 5."""
    recording = fly()
    others = {**recording.counters, dead: count(3.0)}
    one = verdict_of(verdict_on(fly({4: decay(2.0, 0.5)}, counters=others)), 4)
    assert one.verdict == kind
    assert (f"UAV {dead} silent from 2.80 s" in one.reason) == (kind == "void")


def test_a_met_deadline_is_met_whatever_was_saturated(fly: Fly, count: Callable[..., Any]) -> None:
    others = {4: count(12.0, saturated_s=0.7)}
    assert verdict_of(verdict_on(fly({4: decay(2.0, 1.0)}, counters=others)), 4).verdict == "met"


CHANGE = {"at_s": 7.0, "over_s": 2.0, "scale": [2.0, 1.0, 1.0]}
CHANGING = {
    "timing.duration_s": 12.0,
    "formation.task": "relative_position",
    "formation.changes": [CHANGE],
}


def in_places(fly: Fly, errors: dict[int, Any]) -> Recording:
    """A flight of a shape that becomes twice as wide, in which UAV i is errors[i](t) metres north of its place."""
    scenario = load_scenario("paper_5_free", CHANGING)
    recording = fly(scenario=scenario)
    for uav in scenario.followers:
        track = recording.odometry[uav]
        t = track.t_ns * 1e-9
        beside = places_beside_leader(scenario, uav, t)
        track.values[:, :3] += beside - scenario.offset(uav)
        track.values[:, 1] += errors.get(uav, np.zeros_like)(t)
    return recording


def test_a_change_is_judged_when_it_is_due(fly: Fly) -> None:
    verdict = verdict_on(in_places(fly, {}))
    assert verdict.verdict == "met"
    for one in verdict.uavs:
        (change,) = one.changes
        assert (change.number, change.due_s, change.excused) == (1, 9.0, False)
        assert change.error_m == pytest.approx(0.0, abs=1e-9)


def test_a_change_that_comes_too_late_is_missed(fly: Fly) -> None:
    """Six centimetres are inside the band of a UAV that started ten metres away, and outside the tolerance."""
    late = {4: lambda t: np.where(t < 3.0, 10.0, np.where((t > 7.5) & (t < 9.5), 0.06, 0.0))}
    verdict = verdict_on(in_places(fly, late))
    missed = verdict_of(verdict, 4)
    assert missed.band_m == pytest.approx(0.2)
    assert missed.verdict == "missed"
    assert missed.reason.startswith("0.060 m off at 9.00 s, when change 1 of the shape was due")
    assert verdict_of(verdict, 3).verdict == "met"


def test_a_change_after_the_end_of_the_recording_is_not_judged(fly: Fly) -> None:
    late = {**CHANGING, "formation.changes": [{**CHANGE, "at_s": 11.5}]}
    verdict = verdict_on(fly(scenario=load_scenario("paper_5_free", late)))
    assert verdict_of(verdict, 4).changes[0].error_m is None
