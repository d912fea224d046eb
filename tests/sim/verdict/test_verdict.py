"""The verdict on flights whose errors are written down in advance, and on each leg of a mission."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from synthetic_flights import decay, verdict_of

from ptnsbc_sim import swarm
from ptnsbc_sim.counters import COUNTERS
from ptnsbc_sim.scenario import load_scenario, scenario_from_text
from ptnsbc_sim.scenario.mission.legs import Word
from ptnsbc_sim.verdict import Recording, Track, Verdict, VerdictError, verdict_on
from ptnsbc_sim.verdict.recording import recording_of
from ptnsbc_sim.verdict.verdict import legs_without_deadline
from ptnsbc_tools.tables import reasons, verdict_sentence

Fly = Callable[..., Recording]
SECOND_S = 12.0


def test_perfect_flight_is_met_by_all(fly: Fly) -> None:
    verdict = verdict_on(fly())
    assert verdict.verdict == "met"
    assert verdict.exit_code == 0
    assert [one.settling_s for one in verdict.uavs] == [0.0] * 5
    assert verdict.duration_s == pytest.approx(11.99)


def test_where_the_truth_is_recorded_it_is_what_counts(fly: Fly) -> None:
    """Whatever the UAVs believed; without the truth of all UAVs odometry is all there is."""
    believed, true = fly(), fly({3: lambda t: np.full_like(t, 0.3)})
    verdict = verdict_on(replace(believed, truth=true.odometry))
    assert (verdict.verdict, verdict.judged_by) == ("missed", "truth")
    assert verdict_of(verdict, 3).error_at_deadline_m == pytest.approx(0.3)
    assert verdict_of(verdict_on(replace(true, truth=believed.odometry)), 3).verdict == "met"
    some = {uav: true.odometry[uav] for uav in (1, 2, 3)}
    verdict = verdict_on(replace(believed, truth=some))
    assert (verdict.verdict, verdict.judged_by) == ("met", "odometry")


def test_leader_is_measured_against_its_trajectory(fly: Fly) -> None:
    verdict = verdict_on(fly({1: lambda t: np.full_like(t, 0.3)}))
    assert verdict_of(verdict, 1).error_at_deadline_m == pytest.approx(0.3)
    assert verdict_of(verdict, 3).error_at_deadline_m == pytest.approx(0.0, abs=1e-12)


def test_ticks_missed_before_the_epoch_do_not_count(fly: Fly, count: Callable[..., Any]) -> None:
    early = {4: count(12.0, missed_ticks=17)}
    recording = fly(counters=early, epochs=((2_000_000_000, "form"),))
    assert verdict_on(recording).missed_ticks == 0
    early[4].values[30:, COUNTERS.index("missed_ticks")] += 3
    assert verdict_on(recording).missed_ticks == 3


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


def test_uavs_recorded_at_other_instants_are_interpolated(fly: Fly) -> None:
    recording = fly()
    series = recording.odometry[3]
    t_ns = series.t_ns + 3_000_000
    shifted = type(series)(t_ns, series.at(t_ns))
    verdict = verdict_on(fly(odometry={**recording.odometry, 3: shifted}))
    assert verdict_of(verdict, 3).error_at_deadline_m < 1e-4


def test_a_missing_uav_is_named(fly: Fly) -> None:
    recording = fly()
    others = {uav: series for uav, series in recording.odometry.items() if uav != 4}
    with pytest.raises(VerdictError, match="no message on /uav4/odom"):
        verdict_on(fly(odometry=others))


def test_an_epoch_after_the_end_is_refused(fly: Fly) -> None:
    with pytest.raises(VerdictError, match=r"expected odometry of the leader after"):
        verdict_on(fly(epochs=((60_000_000_000, "form"),)))


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
    assert "2 of 2 legs met." in str(verdict_sentence(verdict))


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
    assert legs_without_deadline(recording) == []
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
    assert verdict_of(verdict_on(held), 3).start_error_m == pytest.approx(2.0)
    in_place = replace(fly(), scenario=scenario)  # nobody passes through a keep-out
    swapped = replace(in_place, slots={in_place.start_ns: {**own, 4: 5, 5: 4}})
    gap = np.linalg.norm(scenario.offset(4) - scenario.offset(5))
    one = verdict_of(verdict_on(swapped), 4)
    assert (one.slot, one.verdict) == (5, "missed")
    assert one.start_error_m == pytest.approx(gap)
    with pytest.raises(VerdictError, match="does not say who takes which slot"):
        verdict_on(replace(held, slots={}))


LEGS = [
    {"kind": "form", "over_s": 5},
    {"kind": "go_to", "name": "there", "position_m": [2, 5, 6], "over_s": 5},
    {"kind": "change", "name": "wide", "scale": [1.5, 1.5, 1.0], "over_s": 3},
    {"kind": "land", "over_s": 16},
]


@lru_cache
def flown(duration_s: float = 32.0, words: tuple[Word, ...] = ()) -> Recording:
    changes = {
        "formation.task": "relative_position",
        "leader.trajectory": {"kind": "hover", "position_m": [0, 5, 6]},
        "timing.duration_s": duration_s,
        "mission": {"legs": LEGS},
    }
    return recording_of(swarm.fly(load_scenario("paper_5_free", changes).with_words(words)))


def moved(recording: Recording, uav: int, begin_s: float, end_s: float, by: Any) -> Recording:
    """The recording with one UAV `by` (3,) [m] beside its place between two times."""
    track = recording.odometry[uav].rows(0, recording.odometry[uav].size)
    values, t = track.values.copy(), track.t_ns * 1e-9
    values[(t >= begin_s) & (t < end_s), :3] += np.array(by)
    odometry = {**recording.odometry, uav: Track(track.t_ns, values)}
    return replace(recording, odometry=odometry)


def words_of(verdict: Verdict) -> dict[str, str]:
    return {leg.name: leg.verdict for leg in verdict.mission}


def test_each_leg_is_judged_when_it_is_due() -> None:
    verdict = verdict_on(flown())
    assert verdict.verdict == "met"
    assert words_of(verdict) == dict.fromkeys(["form-1", "there", "wide", "land-4"], "met")
    assert [(leg.begin_s, leg.due_s) for leg in verdict.mission] == [
        (0.0, 5.0), (5.0, 10.0), (10.0, 13.0), (13.0, 29.0),
    ]  # fmt: skip


def test_who_is_late_is_named_in_the_leg() -> None:
    late = verdict_on(moved(flown(), 3, 9.5, 10.5, [0.2, 0, 0]))
    assert words_of(late)["there"] == "missed"
    assert words_of(late)["wide"] == "met"
    reason = late.mission[1].reason
    assert reason.startswith("UAV 3 0.2")
    assert "off at 10.00 s, expected at most 0.05 m" in reason
    assert late.verdict == "missed"


def test_who_is_still_in_the_air_has_not_landed() -> None:
    late = verdict_on(moved(flown(), 3, 28.0, 30.0, [0, 0, 5.0]))
    assert words_of(late)["land-4"] == "missed"
    assert "above the ground at 29.00 s" in late.mission[3].reason
    assert late.verdict == "missed"


@pytest.mark.parametrize(("height_m", "word"), [(0.02, "met"), (1.0, "void")])
def test_who_is_down_before_the_landing_is_due_has_landed(height_m: float, word: str) -> None:
    """As real vehicles: the record of each ends when it is disarmed."""
    recording, odometry = flown(), {}
    for uav, end_s in {2: 25.0, 3: 26.0}.items():
        track = recording.odometry[uav].rows(0, recording.odometry[uav].size)
        kept, values = track.t_ns <= end_s * 1e9, track.values.copy()
        values[track.t_ns >= (end_s - 1.0) * 1e9, 2] = height_m if uav == 3 else 0.0
        odometry[uav] = Track(track.t_ns[kept], values[kept])
    verdict = verdict_on(replace(recording, odometry={**recording.odometry, **odometry}))
    assert words_of(verdict) == {
        **dict.fromkeys(["form-1", "there", "wide"], "met"),
        "land-4": word,
    }
    assert verdict.exit_code == (word == "void")


def test_a_keep_out_violates_the_leg_in_which_it_was_entered() -> None:
    recording = flown()
    near = recording.odometry[2].at(np.array([11_000_000_000]))[0, :3]
    own = recording.odometry[3].at(np.array([11_000_000_000]))[0, :3]
    verdict = verdict_on(moved(recording, 3, 11.0, 11.1, near - own))
    assert words_of(verdict)["wide"] == "violated"
    assert words_of(verdict)["there"] == "met"
    assert verdict.mission[2].reason.startswith(("uav2 0.0", "uav3 0.0"))


def test_a_leg_that_is_due_after_the_flight_is_not_judged() -> None:
    assert list(words_of(verdict_on(flown(12.0)))) == ["form-1", "there"]


def test_a_leg_that_is_not_in_the_recording_is_void() -> None:
    recording = flown()
    cut = {uav: track.rows(0, 600) for uav, track in recording.odometry.items()}
    odometry = {uav: Track(rows.t_ns, rows.values) for uav, rows in cut.items()}
    verdict = verdict_on(replace(recording, odometry=odometry))
    found = words_of(verdict)
    assert found["there"] == "void"
    assert verdict.mission[1].reason == "the recording ends after 5.99 s, it was due at 10.00 s"


def test_a_leg_that_an_operator_cancels_is_cut_short() -> None:
    verdict = verdict_on(flown(18.0, (Word(0, 8.0),)))
    assert verdict.verdict == "met"
    assert [(leg.name, leg.verdict) for leg in verdict.mission] == [
        ("form-1", "met"), ("there", "cut short"), ("cancelled", "met"),
    ]  # fmt: skip
    assert verdict.mission[1].reason == "by an operator"
    assert verdict.mission[2].due_s == 12.0
    early = verdict_on(flown(9.5, (Word(0, 8.0), Word(2, 8.5))))
    assert [(leg.name, leg.verdict) for leg in early.mission] == [
        ("form-1", "met"), ("there", "cut short"), ("cancelled", "cut short"),
    ]  # fmt: skip


def test_legs_at_a_time_in_utc_and_on_a_word_are_judged_when_they_are_due() -> None:
    """A leg that nobody begins has no row."""
    legs = [
        LEGS[0],
        {**LEGS[1], "name": "utc", "at": "2026-11-22T12:00:06.5Z"},
        {**LEGS[1], "name": "gate", "on": "word", "position_m": [3, 5, 6]},
        {**LEGS[1], "name": "unsaid", "on": "word"},
    ]
    changes = {
        "leader.trajectory": {"kind": "hover", "position_m": [0, 5, 6]},
        "timing.duration_s": 18,
        "mission": {"start": "2026-11-22T12:00:00Z", "legs": legs},
    }
    said = load_scenario("paper_5_free", changes).with_words((Word(3, 12.25),))
    verdict = verdict_on(recording_of(swarm.fly(said)))
    assert verdict.verdict == "met"
    assert [(leg.name, leg.verdict, leg.begin_s, leg.due_s) for leg in verdict.mission] == [
        ("form-1", "met", 0.0, 5.0),
        ("utc", "met", 6.5, 11.5),
        ("gate", "met", 12.25, 17.25),
    ]


def test_legs_of_no_length_are_no_legs(fly: Fly) -> None:
    """Six legs within 8 ms voided the verdict."""
    repeated = tuple((k * 1_600_000, "form") for k in range(6))
    one, six = (
        verdict_on(fly(seconds=15.0, epochs=epochs)) for epochs in (repeated[-1:], repeated)
    )
    assert (six.verdict, len(six.legs)) == (one.verdict, 1) == ("met", 1)
    assert six.epoch_s == one.epoch_s
