"""The verdict on each leg of a mission."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.mission.legs import Word
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.verdict import Recording, Series, Verdict, verdict_on
from ptnsbc_sim.verdict.headless import recording_of

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
    return recording_of(fly(load_scenario("paper_5_free", changes).with_words(words)))


def moved(recording: Recording, uav: int, begin_s: float, end_s: float, by: Any) -> Recording:
    """The recording with one UAV `by` (3,) [m] beside its place between two times."""
    track = recording.odometry[uav].rows(0, recording.odometry[uav].size)
    values, t = track.values.copy(), track.t_ns * 1e-9
    values[(t >= begin_s) & (t < end_s), :3] += np.array(by)
    odometry = {**recording.odometry, uav: Series(track.t_ns, values)}
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
    odometry = {uav: Series(rows.t_ns, rows.values) for uav, rows in cut.items()}
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
    verdict = verdict_on(recording_of(fly(said)))
    assert verdict.verdict == "met"
    assert [(leg.name, leg.verdict, leg.begin_s, leg.due_s) for leg in verdict.mission] == [
        ("form-1", "met", 0.0, 5.0),
        ("utc", "met", 6.5, 11.5),
        ("gate", "met", 12.25, 17.25),
    ]
