"""What an encounter excuses, and until when."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from synthetic_flights import away, decay, verdict_of

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.constants import recovery_config
from ptnsbc_sim.verdict import Recording, verdict_on
from ptnsbc_sim.verdict.encounters import recovery_s

Fly = Callable[..., Recording]
SWAY = away(8.0, 8.5)


def ramp(t: Any) -> Any:
    return np.clip(t - 7.9, 0.0, 0.6)


@pytest.mark.parametrize("busy", [4, 3, 1])
def test_an_encounter_of_the_uav_or_an_ancestor_excuses_it(
    fly: Fly, count: Callable[..., Any], busy: int
) -> None:
    recording = fly({4: SWAY})
    others = {**recording.counters, busy: count(12.0, ramp)}
    one = verdict_of(verdict_on(fly({4: SWAY}, counters=others)), 4)
    assert one.verdict == "met"
    assert one.max_error_after_m == pytest.approx(0.0, abs=1e-12)
    assert one.encounter_s > 2


def test_an_encounter_of_a_child_excuses_nothing(fly: Fly, count: Callable[..., Any]) -> None:
    recording = fly({4: SWAY})
    others = {**recording.counters, 5: count(12.0, ramp)}
    assert verdict_of(verdict_on(fly({4: SWAY}, counters=others)), 4).verdict == "missed"


def test_recovery_ends(fly: Fly, count: Callable[..., Any]) -> None:
    """The recovery time after the counter's last rise at 8.6 s the error counts again: 1.45 s for who is in place."""
    recording = fly()
    others = {**recording.counters, 4: count(12.0, ramp)}
    late = fly({4: lambda t: np.where(t > 10.1, 0.5, 0.0)}, counters=others)
    assert verdict_of(verdict_on(late), 4).verdict == "missed"
    early = fly({4: lambda t: np.where((t > 8) & (t < 10.0), 0.5, 0.0)}, counters=others)
    assert verdict_of(verdict_on(early), 4).verdict == "met"


@pytest.mark.parametrize(
    ("late", "kind", "text"),
    [
        (-0.1, "met late", "the deadline counted at {:.2f} s"),
        (
            0.1,
            "missed",
            "0.500 m off at {:.2f} s, when it had to be back after an encounter that ended at 5.60 s, in {:.2f} s",
        ),
    ],
)
def test_an_encounter_over_the_deadline_moves_it_to_the_end_of_the_recovery(
    fly: Fly, count: Callable[..., Any], late: float, kind: str, text: str
) -> None:
    """The counter rises last at 5.6 s; a recovery time later the UAV has to be back."""
    due_s = 5.6 + recovery_s(load_scenario("paper_5_free"), 0.5)
    others = {4: count(12.0, lambda t: np.clip(t - 4.5, 0.0, 1.05))}
    one = verdict_of(verdict_on(fly({4: away(4.0, due_s + late)}, counters=others)), 4)
    assert one.verdict == kind
    assert one.due_s == pytest.approx(due_s)
    assert one.error_at_deadline_m == pytest.approx(0.5)
    assert (one.excuse or one.reason).endswith(text.format(due_s, due_s - 5.6))
    assert one.max_error_after_all_m == pytest.approx(0.5)


def test_who_gave_way_over_the_deadline_is_met_late(fly: Fly, count: Callable[..., Any]) -> None:
    """Neither met nor missed: to what it gave way, and when it was in place. To the strict it is missed."""
    busy = count(12.0, lambda t: np.clip(t - 4.5, 0.0, 1.05))
    beside = fly({4: away(4.0, 6.0)}).odometry[4].values[500, :3] + [0.0, 0.0, 0.6]
    tree = {"name": "tree", "position_m": beside.tolist(), "keep_out_m": 0.3}
    scenario = load_scenario("paper_5_free", {"timing.duration_s": 12, "world.obstacles": [tree]})
    verdict = verdict_on(fly({4: away(4.0, 6.0)}, counters={4: busy}, scenario=scenario))
    one = verdict_of(verdict, 4)
    assert (one.verdict, one.in_place, one.gave_way_to) == ("met late", False, ("tree",))
    assert one.arrived_s == pytest.approx(5.99)
    assert one.reason == (
        "0.500 m off at the deadline because it gave way to tree, in place at 5.99 s"
    )
    assert (verdict.verdict, verdict.exit_code) == ("met late", 0)
    assert verdict.as_json()["in_place"] == {"count": 4, "of": 5}
    strict = verdict.strict()
    assert (strict.verdict, strict.exit_code, strict.legs[0].verdict) == ("missed", 1, "missed")
    assert verdict_of(strict, 4).reason == one.reason


@pytest.mark.parametrize(("late", "kind"), [(-0.3, "met"), (0.3, "missed")])
def test_a_place_is_regained_within_the_recovery_time(
    fly: Fly, count: Callable[..., Any], late: float, kind: str
) -> None:
    """After the deadline too: the counter rises last at 7.6 s, and the verdict says how long the way back took."""
    promised_s = recovery_s(load_scenario("paper_5_free"), 0.5)
    others = {4: count(12.0, lambda t: np.clip(t - 6.5, 0.0, 1.05))}
    back = 7.6 + promised_s + late
    one = verdict_of(verdict_on(fly({4: away(7.0, back)}, counters=others)), 4)
    assert one.verdict == kind
    assert one.recovery_s == pytest.approx(promised_s, abs=0.011)
    if kind == "met":
        assert one.regained_s == pytest.approx(promised_s + late, abs=0.011)
    else:
        text = f"not back after an encounter that ended at 7.60 s, in {promised_s:.2f} s"
        assert one.reason.endswith(text)


def test_who_is_farther_off_has_longer(fly: Fly, count: Callable[..., Any]) -> None:
    scenario = load_scenario("paper_5_free")
    near, far, farther, farthest = (recovery_s(scenario, away) for away in (0.0, 0.7, 2.8, 8.0))
    assert near < far < farther < farthest
    assert near == pytest.approx(scenario.formation.recovery_s + 1.0 / 2.2)
    assert farther - 1.0 / 2.2 == pytest.approx(2.0 * (far - 1.0 / 2.2), rel=0.01)
    speed = min(recovery_config(scenario, uav).speed for uav in scenario.uav_ids)
    assert farthest - 1.0 / 2.2 == pytest.approx(2.1875 * 8.0 / speed, rel=0.01)
    paper = load_scenario("paper_5_free", {"formation.approach": "task"})
    assert recovery_s(paper, 1.0) == recovery_s(paper, 4.0)


def test_an_encounter_until_the_end_is_no_excuse(fly: Fly, count: Callable[..., Any]) -> None:
    others = {4: count(12.0, lambda t: np.maximum(t - 4.5, 0.0))}
    one = verdict_of(verdict_on(fly({4: away(4.0, 9.0)}, counters=others)), 4)
    assert (one.verdict, one.max_error_after_m) == ("missed", None)
    assert one.reason.endswith("an encounter lasts over the deadline until the end")


@pytest.mark.parametrize(("back", "kind"), [(9.4, "met"), (9.8, "missed")])
def test_a_uav_that_is_excused_for_most_of_the_time_is_not_met(
    fly: Fly, count: Callable[..., Any], back: float, kind: str
) -> None:
    """The flight goes on for 6.99 s after the deadline; half of them may be excused, 3.495 s."""
    others = {4: count(12.0, lambda t: np.clip(t - 5.9, 0.0, 2.6))}
    one = verdict_of(verdict_on(fly({4: away(6.0, back)}, counters=others)), 4)
    assert one.verdict == kind
    assert one.excused_outside_s == pytest.approx(back - 6.0, abs=0.011)
    assert one.max_error_after_m == pytest.approx(0.0, abs=1e-12)
    if kind == "missed":
        assert one.reason == (
            "outside 0.050 m near objects for 3.79 s of the 6.99 s after the deadline"
        )


def test_who_stays_in_its_place_needs_no_excuse(fly: Fly, count: Callable[..., Any]) -> None:
    """However long it gives way by millimetres."""
    others = {4: count(12.0, lambda t: t)}
    one = verdict_of(verdict_on(fly({4: lambda t: np.full_like(t, 0.01)}, counters=others)), 4)
    assert (one.verdict, one.excuse, one.excused_outside_s) == ("met", "", 0.0)
    assert one.max_error_after_all_m == pytest.approx(0.01)


def test_keeping_clear_before_the_deadline_hides_nothing(
    fly: Fly, count: Callable[..., Any]
) -> None:
    others = {4: count(12.0, lambda t: np.clip(t - 1.0, 0.0, 1.0))}
    one = verdict_of(verdict_on(fly({4: decay(2.0, 1.0)}, counters=others)), 4)
    assert (one.verdict, one.settling_s) == ("met", pytest.approx(3.69))


def test_no_encounter_excuses_a_deadline_that_the_limits_do_not_allow(
    fly: Fly, count: Callable[..., Any]
) -> None:
    """60 m in 5 s ask for 26 m/s. From half a metre the same flight meets at the end of its way back."""
    busy = {4: count(12.0, lambda t: np.clip(t - 4.5, 0.0, 1.05))}
    found = {}
    for start_m in (0.5, 60.0):
        errors = {4: lambda t, m=start_m: np.where(t < 4.0, m, np.where(t < 5.7, 0.5, 0.0))}
        found[start_m] = verdict_of(verdict_on(fly(errors, counters=busy)), 4)
    assert found[0.5].verdict == "met late"
    assert found[60.0].verdict == "missed"
    assert "the limits allow no deadline below 15.90 s" in found[60.0].reason
    assert found[60.0].reason.endswith("s, which no encounter excuses")
