"""The verdict on flights whose errors are written down in advance."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ptnsbc_sim.scenario import load_scenario, scenario_from_text
from ptnsbc_sim.scenario.build import places_beside_leader
from ptnsbc_sim.verdict import Recording, VerdictError, verdict_on
from ptnsbc_sim.verdict.encounters import recovery_s
from ptnsbc_sim.verdict.recording import COUNTERS
from ptnsbc_sim.verdict.verdict import Verdict
from ptnsbc_tools.tables import reasons, verdict_line, verdict_tables

Fly = Callable[..., Recording]
NEVER = np.zeros_like


def decay(start: float, rate: float) -> Callable[[Any], Any]:
    return lambda t: start * np.exp(-rate * t)


def of(verdict: Verdict, uav: int) -> Any:
    return next(one for one in verdict.uavs if one.uav == uav)


def test_perfect_flight_is_met_by_all(fly: Fly) -> None:
    verdict = verdict_on(fly())
    assert verdict.verdict == "met"
    assert verdict.exit_code == 0
    assert [one.settling_s for one in verdict.uavs] == [0.0] * 5
    assert verdict.duration_s == pytest.approx(11.99)


def test_settling_of_an_exponential(fly: Fly) -> None:
    """2 exp(-t) is last above 0.05 at t = ln 40 = 3.689 s: settled at the next sample, 3.69 s."""
    one = of(verdict_on(fly({3: decay(-2.0, 1.0)})), 3)
    assert one.verdict == "met"
    assert one.settling_s == pytest.approx(3.69)
    assert one.start_error_m == pytest.approx(2.0)
    assert one.error_at_deadline_m == pytest.approx(2 * np.exp(-5))
    assert one.residual == pytest.approx(np.exp(-5))
    assert one.max_error_after_m == pytest.approx(2 * np.exp(-5))


def test_a_large_start_widens_the_band_to_two_percent(fly: Fly) -> None:
    one = of(verdict_on(fly({3: decay(10.0, 2.0)})), 3)
    assert one.band_m == pytest.approx(0.2)
    assert one.settling_s == pytest.approx(np.log(50) / 2, abs=0.01)


def test_late_is_missed(fly: Fly) -> None:
    verdict = verdict_on(fly({4: decay(2.0, 0.5)}))
    one = of(verdict, 4)
    assert (one.verdict, verdict.verdict, verdict.exit_code) == ("missed", "missed", 1)
    assert one.reason == "settled after 7.38 s"
    assert of(verdict, 5).verdict == "met"


def test_inside_the_band_but_above_the_limit_is_missed(fly: Fly) -> None:
    one = of(verdict_on(fly({3: lambda t: np.where(t < 1, 8.0, 0.1)})), 3)
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
    assert of(verdict_on(recording), 3).tolerance_m == 0.1
    assert verdict_on(recording, tolerance=0.05).verdict == "missed"


def test_where_the_truth_is_recorded_it_is_what_counts(fly: Fly) -> None:
    """Whatever the UAVs believed; without the truth of all UAVs odometry is all there is."""
    believed, true = fly(), fly({3: lambda t: np.full_like(t, 0.3)})
    verdict = verdict_on(replace(believed, truth=true.odometry))
    assert (verdict.verdict, verdict.judged_by) == ("missed", "truth")
    assert of(verdict, 3).error_at_deadline_m == pytest.approx(0.3)
    assert of(verdict_on(replace(true, truth=believed.odometry)), 3).verdict == "met"
    some = {uav: true.odometry[uav] for uav in (1, 2, 3)}
    verdict = verdict_on(replace(believed, truth=some))
    assert (verdict.verdict, verdict.judged_by) == ("met", "odometry")


def test_leader_is_measured_against_its_trajectory(fly: Fly) -> None:
    verdict = verdict_on(fly({1: lambda t: np.full_like(t, 0.3)}))
    assert of(verdict, 1).error_at_deadline_m == pytest.approx(0.3)
    assert of(verdict, 3).error_at_deadline_m == pytest.approx(0.0, abs=1e-12)


def bump(t: Any) -> Any:
    return np.where((t > 8.0) & (t < 8.5), 0.5, 0.0)


def ramp(t: Any) -> Any:
    return np.clip(t - 7.9, 0.0, 0.6)


def test_an_error_after_the_deadline_is_missed(fly: Fly) -> None:
    one = of(verdict_on(fly({4: bump})), 4)
    assert one.verdict == "missed"
    assert one.reason == "met at the deadline, but outside 0.050 m again until 8.50 s"


def test_only_what_came_before_the_exit_voids_it(fly: Fly, count: Callable[..., Any]) -> None:
    def held(since: int) -> dict[int, Any]:
        counters = count(12.0, holding_s=0.7)
        counters.values[:since, COUNTERS.index("holding_s")] = 0.0
        return {4: counters}

    assert of(verdict_on(fly({4: bump}, counters=held(5))), 4).verdict == "missed"
    assert of(verdict_on(fly({4: bump}, counters=held(38))), 4).verdict == "void"
    assert of(verdict_on(fly({4: bump}, counters=held(50))), 4).verdict == "missed"


@pytest.mark.parametrize("busy", [4, 3, 1])
def test_an_encounter_of_the_uav_or_an_ancestor_excuses_it(
    fly: Fly, count: Callable[..., Any], busy: int
) -> None:
    recording = fly({4: bump})
    others = {**recording.counters, busy: count(12.0, ramp)}
    one = of(verdict_on(fly({4: bump}, counters=others)), 4)
    assert one.verdict == "met"
    assert one.max_error_after_m == pytest.approx(0.0, abs=1e-12)
    assert one.encounter_s > 2


def test_an_encounter_of_a_child_excuses_nothing(fly: Fly, count: Callable[..., Any]) -> None:
    recording = fly({4: bump})
    others = {**recording.counters, 5: count(12.0, ramp)}
    assert of(verdict_on(fly({4: bump}, counters=others)), 4).verdict == "missed"


def test_recovery_ends(fly: Fly, count: Callable[..., Any]) -> None:
    """The recovery time after the counter's last rise at 8.6 s the error counts again: 1.45 s for who is in place."""
    recording = fly()
    others = {**recording.counters, 4: count(12.0, ramp)}
    late = fly({4: lambda t: np.where(t > 10.1, 0.5, 0.0)}, counters=others)
    assert of(verdict_on(late), 4).verdict == "missed"
    early = fly({4: lambda t: np.where((t > 8) & (t < 10.0), 0.5, 0.0)}, counters=others)
    assert of(verdict_on(early), 4).verdict == "met"


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
    assert of(verdict, 4).verdict == kind
    assert of(verdict, 4).reason.endswith(reason)
    assert verdict.exit_code == 1


@pytest.mark.parametrize(("dead", "kind"), [(4, "void"), (1, "void"), (5, "missed")])
def test_a_lost_process_voids_its_own_miss_and_those_that_depend_on_it(
    fly: Fly, count: Callable[..., Any], dead: int, kind: str
) -> None:
    """Whatever messages the scenario loses; UAV 4 does not depend on UAV 5."""
    recording = fly()
    others = {**recording.counters, dead: count(3.0)}
    one = of(verdict_on(fly({4: decay(2.0, 0.5)}, counters=others)), 4)
    assert one.verdict == kind
    assert (f"UAV {dead} silent from 2.80 s" in one.reason) == (kind == "void")


def test_a_met_deadline_is_met_whatever_was_saturated(fly: Fly, count: Callable[..., Any]) -> None:
    others = {4: count(12.0, saturated_s=0.7)}
    assert of(verdict_on(fly({4: decay(2.0, 1.0)}, counters=others)), 4).verdict == "met"


def test_ticks_missed_before_the_epoch_do_not_count(fly: Fly, count: Callable[..., Any]) -> None:
    early = {4: count(12.0, missed_ticks=17)}
    recording = fly(counters=early, epochs=((2_000_000_000, "form"),))
    assert verdict_on(recording).missed_ticks == 0
    early[4].values[30:, COUNTERS.index("missed_ticks")] += 3
    assert verdict_on(recording).missed_ticks == 3


def away(begin: float, back: float) -> Callable[[Any], Any]:
    """Half a metre off from `begin` to `back`."""
    return lambda t: np.where((t > begin) & (t < back), 0.5, 0.0)


@pytest.mark.parametrize(
    ("late", "kind", "text"),
    [
        (-0.1, "met", "the deadline counted at {:.2f} s"),
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
    one = of(verdict_on(fly({4: away(4.0, due_s + late)}, counters=others)), 4)
    assert one.verdict == kind
    assert one.due_s == pytest.approx(due_s)
    assert one.error_at_deadline_m == pytest.approx(0.5)
    assert (one.excuse or one.reason).endswith(text.format(due_s, due_s - 5.6))
    assert one.max_error_after_all_m == pytest.approx(0.5)


@pytest.mark.parametrize(("late", "kind"), [(-0.3, "met"), (0.3, "missed")])
def test_a_place_is_regained_within_the_recovery_time(
    fly: Fly, count: Callable[..., Any], late: float, kind: str
) -> None:
    """After the deadline too: the counter rises last at 7.6 s, and the verdict says how long the way back took."""
    promised_s = recovery_s(load_scenario("paper_5_free"), 0.5)
    others = {4: count(12.0, lambda t: np.clip(t - 6.5, 0.0, 1.05))}
    back = 7.6 + promised_s + late
    one = of(verdict_on(fly({4: away(7.0, back)}, counters=others)), 4)
    assert one.verdict == kind
    assert one.recovery_s == pytest.approx(promised_s, abs=0.011)
    if kind == "met":
        assert one.regained_s == pytest.approx(promised_s + late, abs=0.011)
    else:
        text = f"not back after an encounter that ended at 7.60 s, in {promised_s:.2f} s"
        assert one.reason.endswith(text)


def test_who_is_farther_off_has_longer(fly: Fly, count: Callable[..., Any]) -> None:
    scenario = load_scenario("paper_5_free")
    near, far, farthest = (recovery_s(scenario, away) for away in (0.0, 1.0, 4.0))
    assert near < far < farthest
    assert near == pytest.approx(scenario.file.formation.recovery_s + 1.0 / 2.2)
    assert farthest - 1.0 / 2.2 == pytest.approx(2.0 * (far - 1.0 / 2.2), rel=0.01)
    paper = load_scenario("paper_5_free", {"formation.approach": "task"})
    assert recovery_s(paper, 1.0) == recovery_s(paper, 4.0)


def test_an_encounter_until_the_end_is_no_excuse(fly: Fly, count: Callable[..., Any]) -> None:
    others = {4: count(12.0, lambda t: np.maximum(t - 4.5, 0.0))}
    one = of(verdict_on(fly({4: away(4.0, 9.0)}, counters=others)), 4)
    assert (one.verdict, one.max_error_after_m) == ("missed", None)
    assert one.reason.endswith("an encounter lasts over the deadline until the end")


@pytest.mark.parametrize(("back", "kind"), [(9.4, "met"), (9.8, "missed")])
def test_a_uav_that_is_excused_for_most_of_the_time_is_not_met(
    fly: Fly, count: Callable[..., Any], back: float, kind: str
) -> None:
    """The flight goes on for 6.99 s after the deadline; half of them may be excused, 3.495 s."""
    others = {4: count(12.0, lambda t: np.clip(t - 5.9, 0.0, 2.6))}
    one = of(verdict_on(fly({4: away(6.0, back)}, counters=others)), 4)
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
    one = of(verdict_on(fly({4: lambda t: np.full_like(t, 0.01)}, counters=others)), 4)
    assert (one.verdict, one.excuse, one.excused_outside_s) == ("met", "", 0.0)
    assert one.max_error_after_all_m == pytest.approx(0.01)


def test_keeping_clear_before_the_deadline_hides_nothing(
    fly: Fly, count: Callable[..., Any]
) -> None:
    others = {4: count(12.0, lambda t: np.clip(t - 1.0, 0.0, 1.0))}
    one = of(verdict_on(fly({4: decay(2.0, 1.0)}, counters=others)), 4)
    assert (one.verdict, one.settling_s) == ("met", pytest.approx(3.69))


def test_a_recording_that_ends_early_is_void(fly: Fly) -> None:
    verdict = verdict_on(fly(seconds=3.0))
    assert verdict.verdict == "void"
    assert verdict.uavs[0].reason == "recording ends after 2.99 s"
    assert verdict.uavs[0].error_at_deadline_m is None


def test_not_a_number_is_missed(fly: Fly) -> None:
    recording = fly()
    recording.odometry[4].values[620:, 8] = np.nan
    recording.wrench[5].values[123, 3] = np.inf
    verdict = verdict_on(recording)
    assert (verdict.verdict, verdict.exit_code) == ("missed", 1)
    assert of(verdict, 4).reason == "state not finite from t = 6.20 s"
    assert of(verdict, 5).reason == "state not finite from t = 1.23 s"
    assert of(verdict, 4).verdict == of(verdict, 5).verdict == "missed"
    assert of(verdict, 4).settling_s is None
    assert [of(verdict, uav).verdict for uav in (1, 2, 3)] == ["met"] * 3


def test_a_flight_of_nothing_but_nan_is_missed_and_can_be_printed(fly: Fly) -> None:
    recording = fly()
    for series in (*recording.odometry.values(), *recording.wrench.values()):
        series.values[:] = np.nan
    verdict = verdict_on(recording)
    assert {one.verdict for one in verdict.uavs} == {"missed"}
    assert json.loads(json.dumps(verdict.as_json(), allow_nan=False))["verdict"] == "missed"
    assert verdict_tables(verdict)


def test_without_the_leaders_place_no_follower_has_an_error(fly: Fly) -> None:
    recording = fly()
    recording.odometry[1].values[300:, 0] = np.nan
    verdict = verdict_on(recording)
    assert {one.verdict for one in verdict.uavs} == {"missed"}
    assert of(verdict, 1).reason == "state not finite from t = 3.00 s"
    assert of(verdict, 4).reason == "error not finite from t = 3.00 s"


def test_a_few_missing_messages_are_counted(fly: Fly, without: Callable[..., Any]) -> None:
    recording = fly()
    odometry = {**recording.odometry, 3: without(recording.odometry[3], 100, 101, 102, 700)}
    verdict = verdict_on(fly(odometry=odometry))
    assert verdict.verdict == "met"
    assert [one.missing for one in verdict.uavs] == [0, 0, 4, 0, 0]
    assert of(verdict, 3).longest_gap_s == pytest.approx(0.04)
    assert of(verdict, 4).longest_gap_s == pytest.approx(0.01)


@pytest.mark.parametrize(("ticks", "kind"), [(24, "met"), (25, "void")])
def test_a_gap_longer_than_a_quarter_of_a_second_is_void(
    fly: Fly, without: Callable[..., Any], ticks: int, kind: str
) -> None:
    recording = fly()
    cut = without(recording.odometry[3], *range(401, 401 + ticks))
    verdict = verdict_on(fly(odometry={**recording.odometry, 3: cut}))
    one = of(verdict, 3)
    assert (one.verdict, one.missing) == (kind, ticks)
    assert of(verdict, 4).verdict == "met"
    if kind == "void":
        nothing = "nothing on /uav3/odom for 0.26 s from t = 4.00 s"
        assert one.reason == f"recording incomplete: {nothing}"
        assert verdict.exit_code == 1


def test_a_gap_of_the_leader_voids_everybody(fly: Fly, without: Callable[..., Any]) -> None:
    recording = fly({4: decay(2.0, 0.5)})
    cut = without(recording.odometry[1], *range(100, 200))
    odometry = {**recording.odometry, 1: cut}
    verdict = verdict_on(fly(odometry=odometry))
    assert {one.verdict for one in verdict.uavs} == {"void"}
    assert "nothing on /uav1/odom for 1.01 s" in of(verdict, 4).reason
    assert of(verdict, 4).reason.endswith("settled after 7.38 s")
    assert of(verdict, 4).missing == 0


def test_silence_after_the_epoch_is_a_gap(fly: Fly, without: Callable[..., Any]) -> None:
    recording = fly()
    late = {**recording.odometry, 2: without(recording.odometry[2], *range(60))}
    one = of(verdict_on(fly(odometry=late)), 2)
    assert one.reason == "recording incomplete: nothing on /uav2/odom for 0.60 s from t = 0.00 s"


@pytest.mark.parametrize(("ticks", "kind"), [(25, "met"), (26, "void")])
def test_a_recording_cut_before_the_end_of_the_flight_is_void(
    fly: Fly, without: Callable[..., Any], ticks: int, kind: str
) -> None:
    recording = fly()
    cut = without(recording.odometry[5], *range(1200 - ticks, 1200))
    verdict = verdict_on(fly(odometry={**recording.odometry, 5: cut}))
    assert {one.verdict for one in verdict.uavs} == {kind}
    if kind == "void":
        reason = "recording incomplete: /uav5/odom ends after 11.73 s of 12.00 s"
        assert verdict.uavs[0].reason == reason


def test_a_missing_wrench_is_held_not_dropped(fly: Fly, without: Callable[..., Any]) -> None:
    """A weight held for 11.99 s costs the same with and without two thirds of its messages."""
    recording = fly()
    gone = [tick for tick in range(1200) if tick % 3]
    wrench = {**recording.wrench, 2: without(recording.wrench[2], *gone)}
    one = next(one for one in verdict_on(fly(wrench=wrench)).efforts if one.uav == 2)
    assert one.energy == pytest.approx((1.2 * 9.81) ** 2 * 11.99)
    assert one.missing == 800


def test_time_counts_from_the_epoch_to_the_next(fly: Fly) -> None:
    verdict = verdict_on(fly(epochs=((2_000_000_000, "form"), (9_000_000_000, "land"))))
    assert verdict.epoch_s == pytest.approx(2.0)
    assert verdict.duration_s == pytest.approx(7.0)


def test_input_of_a_hover_with_one_peak(fly: Fly) -> None:
    recording = fly()
    weight = 1.2 * 9.81
    recording.wrench[2].values[200, 2] = weight + 3.0
    one = next(one for one in verdict_on(recording).efforts if one.uav == 2)
    assert one.initial_above_hover_n == pytest.approx(0.0)
    assert one.peak_force_n == pytest.approx(weight + 3.0)
    assert one.peak_at_s == pytest.approx(2.0)
    assert one.energy_above_hover == pytest.approx(9.0 * 0.01)
    assert one.energy == pytest.approx(weight**2 * 11.98 + (weight + 3.0) ** 2 * 0.01)


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
    assert of(verdict, 3).reason == text
    assert "inside a keep-out for 1.00 s" in str(verdict_line(verdict))


def test_a_violated_uav_that_is_late_says_both(fly: Fly) -> None:
    one = of(verdict_on(fly({3: lambda t: np.where((t >= 2) & (t < 6), 0.8, 0.0)})), 3)
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
    assert of(verdict, 2).verdict == "violated"
    assert of(verdict, 2).reason.startswith("0.000 m from O9 at 7.00 s")


def test_obstacles_are_named(fly: Fly) -> None:
    names = {one.second for one in verdict_on(fly(scenario=load_scenario("paper_5"))).separations}
    assert {"O1", "O2"} <= names


def test_uavs_recorded_at_other_instants_are_interpolated(fly: Fly) -> None:
    recording = fly()
    series = recording.odometry[3]
    t_ns = series.t_ns + 3_000_000
    shifted = type(series)(t_ns, series.at(t_ns))
    verdict = verdict_on(fly(odometry={**recording.odometry, 3: shifted}))
    assert of(verdict, 3).error_at_deadline_m < 1e-4


def test_a_missing_uav_is_named(fly: Fly) -> None:
    recording = fly()
    others = {uav: series for uav, series in recording.odometry.items() if uav != 4}
    with pytest.raises(VerdictError, match="no message on /uav4/odom"):
        verdict_on(fly(odometry=others))


def test_an_epoch_after_the_end_is_refused(fly: Fly) -> None:
    with pytest.raises(VerdictError, match=r"expected odometry of the leader after"):
        verdict_on(fly(epochs=((60_000_000_000, "form"),)))


# Legs

SECOND_S = 12.0


def epochs(*legs: tuple[float, str]) -> tuple[tuple[int, str], ...]:
    return tuple((round(t_s * 1e9), name) for t_s, name in legs)


@pytest.fixture
def twice(fly):
    """UAV 4 is a metre away from the second epoch on, and back `back` seconds later."""

    def flown(back: float, *more: tuple[float, str], seconds: float = 20.0):
        away = lambda t: np.where((t > SECOND_S) & (t < SECOND_S + back), 1.0, 0.0)  # noqa: E731
        legs = epochs((0.0, "form"), (SECOND_S, "form"), *more)
        return fly({4: away}, seconds=seconds, epochs=legs)

    return flown


def test_both_legs_met(twice):
    verdict = verdict_on(twice(3.0))
    assert [leg.verdict for leg in verdict.legs] == ["met", "met"]
    assert verdict.verdict == "met"
    first, second = verdict.legs
    assert (first.epoch_s, first.duration_s) == (0.0, pytest.approx(12.0))
    assert (second.epoch_s, second.duration_s) == (12.0, pytest.approx(7.99))
    assert second.uavs[3].settling_s == pytest.approx(3.0)
    assert verdict.uavs == first.uavs
    assert "10 met in 2 legs" in str(verdict_line(verdict))


def test_the_leader_follows_its_path_through_all_legs(twice):
    """Its trajectory counts from the first epoch: a new one does not begin it anew."""
    leader = verdict_on(twice(3.0)).legs[1].uavs[0]
    assert leader.start_error_m == pytest.approx(0.0, abs=1e-9)


def test_second_leg_missed(twice):
    verdict = verdict_on(twice(6.0))
    assert [leg.verdict for leg in verdict.legs] == ["met", "missed"]
    assert (verdict.verdict, verdict.exit_code) == ("missed", 1)
    (line,) = map(str, reasons(verdict))
    assert line.startswith("leg 2 from 12.00 s, UAV 4 missed: settled after 6.00 s")


def test_hold_ends_a_leg_and_is_not_judged(twice):
    verdict = verdict_on(twice(3.0, (18.0, "hold")))
    assert len(verdict.legs) == 2
    assert verdict.legs[1].duration_s == pytest.approx(6.0)


@pytest.mark.parametrize("leg", ["hold", "land"])
def test_a_keep_out_counts_in_legs_without_deadline(fly, leg):
    flown = fly(
        {3: lambda t: np.where((t >= 15) & (t < 16), 0.8, 0.0)},
        seconds=20.0,
        epochs=epochs((0.0, "form"), (12.0, leg)),
    )
    verdict = verdict_on(flown)
    assert [one.verdict for one in verdict.legs] == ["met"]
    assert (verdict.verdict, verdict.exit_code) == ("violated", 1)
    assert verdict.separations[0].at_s == pytest.approx(15.0)
    assert verdict_on(replace(flown, window_s=8.0)).verdict == "met"


def test_a_flight_without_epochs_counts_from_its_first_message(fly):
    recording = fly(epochs=())
    assert recording.other_legs_ns == []
    assert verdict_on(recording).verdict == "met"


def test_separations_of_legs_are_joined(fly):
    flown = fly(
        {3: lambda t: np.where((t >= 7) & (t < 8) | (t >= 15) & (t < 16), 0.8, 0.0)},
        seconds=20.0,
        epochs=epochs((0.0, "form"), (12.0, "form")),
    )
    verdict = verdict_on(flown)
    assert [leg.verdict for leg in verdict.legs] == ["violated", "violated"]
    assert verdict.inside_keep_out_s == pytest.approx(2.0)
    assert "at 15.00 s" in verdict.legs[1].uavs[2].reason


def test_a_leg_without_flight_is_void(twice):
    verdict = verdict_on(twice(0.0, (30.0, "form")))
    assert [leg.verdict for leg in verdict.legs] == ["met", "met", "void"]
    assert verdict.verdict == "void"
    assert "holds no formation flight" in verdict.legs[2].reason
    told = verdict.as_json()["legs"][2]
    assert (told["verdict"], told["uavs"]) == ("void", [])


def test_window(fly):
    """Only what is inside counts, and a window shorter than the deadline answers nothing."""
    flown = fly({2: lambda t: np.where(t > 9.0, 1.0, 0.0)})
    assert verdict_on(flown).verdict == "missed"
    assert verdict_on(replace(flown, window_s=8.0)).verdict == "met"
    short = verdict_on(replace(flown, window_s=4.0))
    assert short.verdict == "void"
    assert short.uavs[1].reason == "recording ends after 4.00 s"


def test_no_flight_at_all(fly):
    with pytest.raises(VerdictError, match="no formation flight"):
        verdict_on(fly(epochs=epochs((100.0, "form"))))


def test_errors_are_those_against_the_slot_that_a_uav_took(fly: Fly) -> None:
    flown = fly({3: decay(2.0, 1.0)})
    text = flown.scenario.text.replace("task:", "assignment: optimal\n  task:", 1)
    scenario = scenario_from_text(text)
    own = {uav: uav for uav in scenario.uav_ids}
    held = replace(flown, scenario=scenario, slots={flown.start_ns: own})
    assert [one.slot for one in verdict_on(held).uavs] == [1, 2, 3, 4, 5]
    assert of(verdict_on(held), 3).start_error_m == pytest.approx(2.0)
    in_place = replace(fly(), scenario=scenario)  # nobody passes through a keep-out
    swapped = replace(in_place, slots={in_place.start_ns: {**own, 4: 5, 5: 4}})
    gap = np.linalg.norm(scenario.offset(4) - scenario.offset(5))
    one = of(verdict_on(swapped), 4)
    assert (one.slot, one.verdict) == (5, "missed")
    assert one.start_error_m == pytest.approx(gap)
    with pytest.raises(VerdictError, match="does not say who takes which slot"):
        verdict_on(replace(held, slots={}))


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
    missed = of(verdict, 4)
    assert missed.band_m == pytest.approx(0.2)
    assert missed.verdict == "missed"
    assert missed.reason.startswith("0.060 m off at 9.00 s, when change 1 of the shape was due")
    assert of(verdict, 3).verdict == "met"


def test_a_change_after_the_end_of_the_recording_is_not_judged(fly: Fly) -> None:
    late = {**CHANGING, "formation.changes": [{**CHANGE, "at_s": 11.5}]}
    verdict = verdict_on(fly(scenario=load_scenario("paper_5_free", late)))
    assert of(verdict, 4).changes[0].error_m is None
