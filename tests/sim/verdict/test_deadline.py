"""Deadlines, their causes of a miss, changes of a shape that are due later, and recordings that lack something."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from synthetic_flights import away, decay, verdict_of

from ptnsbc_sim.counters import COUNTERS
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.swarm import fly as fly_headless
from ptnsbc_sim.verdict import Recording, Track, verdict_on
from ptnsbc_sim.verdict.recording import absences, recording_of
from ptnsbc_tools.tables import verdict_tables

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


EVERY = 2  # 50 Hz of a vehicle in a scenario with 100 Hz of control


@pytest.fixture
def bridged(fly: Fly, without: Callable[..., Any]) -> Fly:
    """A flight at the vehicle's rate, which begins 1 s before the epoch; `gone` are messages of UAV 2 not recorded."""

    def make(*gone: int) -> Recording:
        whole = fly(seconds=13.0)
        odd = [tick for tick in range(1300) if tick % EVERY]
        slow = {uav: without(series, *odd) for uav, series in whole.odometry.items()}
        inputs = {uav: without(series, *odd) for uav, series in whole.wrench.items()}
        stamps = slow[1].t_ns[4::10]  # five times a second
        counts = np.arange(5.0, 5.0 + 10.0 * stamps.size, 10.0)[:, None]
        sent = {uav: Track(stamps, counts) for uav in slow}
        slow[2] = without(slow[2], *gone)
        inputs[2] = without(inputs[2], *gone)
        epochs = ((1_000_000_000, "form"),)
        return fly(seconds=13.0, odometry=slow, wrench=inputs, sent=sent, epochs=epochs)

    return make


def test_a_vehicles_own_rate_is_no_loss(bridged: Fly) -> None:
    found = verdict_on(bridged())
    assert [one.missing for one in found.uavs] == [0] * 5
    assert [one.missing for one in found.efforts] == [0] * 5


def test_what_was_sent_and_not_recorded_is_missing(bridged: Fly) -> None:
    found = verdict_on(bridged(100, 101, 102, 300))
    assert [one.missing for one in found.uavs] == [0, 4, 0, 0, 0]
    assert [one.missing for one in found.efforts] == [0, 4, 0, 0, 0]


def test_what_is_lost_before_the_epoch_does_not_count(bridged: Fly) -> None:
    assert verdict_on(bridged(3, 4, 30)).uavs[1].missing == 0


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
    assert verdict_of(verdict, 4).reason == "state not finite from t = 6.20 s"
    assert verdict_of(verdict, 5).reason == "state not finite from t = 1.23 s"
    assert verdict_of(verdict, 4).verdict == verdict_of(verdict, 5).verdict == "missed"
    assert verdict_of(verdict, 4).settling_s is None
    assert [verdict_of(verdict, uav).verdict for uav in (1, 2, 3)] == ["met"] * 3


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
    assert verdict_of(verdict, 1).reason == "state not finite from t = 3.00 s"
    assert verdict_of(verdict, 4).reason == "error not finite from t = 3.00 s"


def test_a_few_missing_messages_are_counted(fly: Fly, without: Callable[..., Any]) -> None:
    recording = fly()
    odometry = {**recording.odometry, 3: without(recording.odometry[3], 100, 101, 102, 700)}
    verdict = verdict_on(fly(odometry=odometry))
    assert verdict.verdict == "met"
    assert [one.missing for one in verdict.uavs] == [0, 0, 4, 0, 0]
    assert verdict_of(verdict, 3).longest_gap_s == pytest.approx(0.04)
    assert verdict_of(verdict, 4).longest_gap_s == pytest.approx(0.01)


@pytest.mark.parametrize(("ticks", "kind"), [(24, "met"), (25, "void")])
def test_a_gap_longer_than_a_quarter_of_a_second_is_void(
    fly: Fly, without: Callable[..., Any], ticks: int, kind: str
) -> None:
    recording = fly()
    cut = without(recording.odometry[3], *range(401, 401 + ticks))
    verdict = verdict_on(fly(odometry={**recording.odometry, 3: cut}))
    one = verdict_of(verdict, 3)
    assert (one.verdict, one.missing) == (kind, ticks)
    assert verdict_of(verdict, 4).verdict == "met"
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
    assert "nothing on /uav1/odom for 1.01 s" in verdict_of(verdict, 4).reason
    assert verdict_of(verdict, 4).reason.endswith("settled after 7.38 s")
    assert verdict_of(verdict, 4).missing == 0


def test_silence_after_the_epoch_is_a_gap(fly: Fly, without: Callable[..., Any]) -> None:
    recording = fly()
    late = {**recording.odometry, 2: without(recording.odometry[2], *range(60))}
    one = verdict_of(verdict_on(fly(odometry=late)), 2)
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


def until(track: Track, t_s: float) -> Track:
    end = track.index(round(t_s * 1e9), "right")
    return Track(track.t_ns[:end], track.values[:end])


def test_vehicles_that_are_gone_need_not_be_recorded_to_the_end() -> None:
    """Through bridges one that leaves is heard until it has landed, and a lost one as long as its own bridge lives."""
    whole = recording_of(fly_headless(load_scenario("relay")))
    ends_s = {6: 34.0, 1: 36.0}  # UAV 6 leaves at 30 s, UAV 1 is killed at 36 s
    parts = {
        name: {uav: until(one, ends_s.get(uav, 99.0)) for uav, one in getattr(whole, name).items()}
        for name in ("odometry", "wrench", "estimate", "counters")
    }
    found, expected = verdict_on(replace(whole, **parts)), verdict_on(whole)
    assert found.verdict == expected.verdict == "met"
    alike = ("uav", "verdict", "reason", "membership", "error_at_deadline_m", "settling_s")
    for one, other in zip(found.uavs, expected.uavs, strict=True):
        assert [getattr(one, name) for name in alike] == [getattr(other, name) for name in alike]


def test_a_gap_of_one_that_stays_still_makes_the_recording_incomplete() -> None:
    whole = recording_of(fly_headless(load_scenario("relay")))
    odometry = {uav: until(one, 40.0 if uav == 3 else 99.0) for uav, one in whole.odometry.items()}
    found = verdict_on(replace(whole, odometry=odometry))
    assert found.verdict == "void"
    assert "/uav3/odom ends after 40.00 s of 50.00 s" in verdict_of(found, 2).reason


def test_one_that_comes_back_after_the_flight_is_lost() -> None:
    """Processes go on until all vehicles have landed."""
    relay = load_scenario("relay")
    spans_s = [(0.0, 22.0), (51.0, 60.0)]
    stamps = np.concatenate([np.arange(*span, 0.01) for span in spans_s])
    track = Track(np.round(stamps * 1e9).astype(np.int64), np.zeros((stamps.size, 13)))
    (span,) = absences(relay, {5: track}, 0)[5]
    assert span.for_good
    assert span.text(0) == "lost at 22.00 s"


def test_one_that_lands_before_the_others_after_the_flight_is_not_lost() -> None:
    stamps = np.arange(0, 5200, dtype=np.int64) * 10_000_000
    later = np.arange(0, 6000, dtype=np.int64) * 10_000_000
    tracks = {5: Track(stamps, np.zeros((5200, 13))), 2: Track(later, np.zeros((6000, 13)))}
    assert absences(load_scenario("relay"), tracks, 0)[5] == ()
