"""Missing messages, gaps, early ends and numbers that are not finite; vehicles whose bridges count what they sent."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from synthetic_flights import decay, verdict_of

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.swarm import fly as fly_headless
from ptnsbc_sim.verdict import Recording, Series, verdict_on
from ptnsbc_sim.verdict.headless import recording_of
from ptnsbc_sim.verdict.members import absences
from ptnsbc_tools.tables import verdict_tables

Fly = Callable[..., Recording]
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
        sent = {uav: Series(stamps, counts) for uav in slow}
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


def until(track: Series, t_s: float) -> Series:
    end = track.index(round(t_s * 1e9), "right")
    return Series(track.t_ns[:end], track.values[:end])


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
    track = Series(np.round(stamps * 1e9).astype(np.int64), np.zeros((stamps.size, 13)))
    (span,) = absences(relay, {5: track}, 0)[5]
    assert span.for_good
    assert span.text(0) == "lost at 22.00 s"


def test_one_that_lands_before_the_others_after_the_flight_is_not_lost() -> None:
    stamps = np.arange(0, 5200, dtype=np.int64) * 10_000_000
    later = np.arange(0, 6000, dtype=np.int64) * 10_000_000
    tracks = {5: Series(stamps, np.zeros((5200, 13))), 2: Series(later, np.zeros((6000, 13)))}
    assert absences(load_scenario("relay"), tracks, 0)[5] == ()
