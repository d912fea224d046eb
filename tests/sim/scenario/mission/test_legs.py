"""When the legs of a mission begin, and what is refused."""

from typing import Any

import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.scenario.mission.legs import CANCEL, Word
from ptnsbc_sim.scenario.scenario import scenario_from_text

FORM = {"kind": "form", "over_s": 6, "stay_s": 1}
GO = {"kind": "go_to", "position_m": [4, 0, 6], "over_s": 5}
LINE = {"kind": "change", "shape": {"kind": "line", "spacing_m": 2}, "over_s": 4}
HOLD = {"kind": "hold", "over_s": 3}
UNTIMED = {"kind": "waypoints", "points_m": [[0, 0, 1], [1, 0, 1]]}
LAND = {"kind": "land", "over_s": 20}


def mission(*legs: dict[str, Any], **keys: Any) -> Scenario:
    changes = {"formation.task": "relative_position", "timing.duration_s": 60}
    return load_scenario("paper_5_free", {**changes, "mission": {"legs": [*legs], **keys}})


def times(scenario: Scenario) -> list[tuple[float, float, float]]:
    return [(one.begin_s, one.due_s, one.end_s) for one in scenario.legs]


def test_a_leg_begins_when_the_last_is_done_or_at_its_time() -> None:
    found = mission(FORM, GO, {**LINE, "at_s": 20}, {**HOLD, "stay_s": 2}, LAND)
    assert times(found) == [(0, 6, 7), (7, 12, 12), (20, 24, 24), (24, 27, 29), (29, 49, 49)]
    assert [one.name for one in found.legs] == ["form-1", "go_to-2", "change-3", "hold-4", "land-5"]
    assert found.landing_ns == 29_000_000_000
    assert [one.at_s for one in found.file.formation.changes] == [0.0, 20.0]


def test_the_first_leg_says_deadline_shape_and_slots() -> None:
    first = {**FORM, "shape": {"kind": "column", "spacing_m": 3}, "slots": "optimal"}
    found = mission(first)
    assert found.gains.formation.deadline_s == 6.0
    assert found.offset(2).tolist() == [-3, 0, 0]
    assert found.file.formation.assignment == "optimal"


def test_times_in_utc_count_from_the_start_of_the_mission() -> None:
    leg = {**GO, "at": "2026-11-22T12:00:09.5Z"}
    found = mission(FORM, leg, start="2026-11-22T12:00:00Z")
    assert found.legs[1].begin_s == 9.5


def test_a_leg_on_a_word_waits_for_it_and_what_follows_waits_too() -> None:
    found = mission(FORM, {**GO, "on": "word"}, HOLD)
    assert len(found.legs) == 1
    said = found.with_words([Word(2, 11.0)])
    assert times(said)[1:] == [(11, 16, 16), (16, 19, 19)]
    assert said.text == found.text
    assert len(found.legs) == 1


def test_a_leg_on_a_word_begins_without_it_at_its_time() -> None:
    found = mission(FORM, {**GO, "on": "word", "at_s": 15}, HOLD)
    assert found.legs[1].begin_s == 15.0
    assert times(found.with_words([Word(2, 9.0)]))[1:] == [(9, 14, 14), (14, 17, 17)]


def test_a_word_drops_what_would_begin_after_it() -> None:
    found = mission(FORM, GO, LINE, HOLD, LAND)
    assert [one.number for one in found.with_words([Word(4, 10.0)]).legs] == [1, 2, 4, 5]
    stopped = found.with_words([Word(CANCEL, 10.0)])
    assert [one.name for one in stopped.legs] == ["form-1", "go_to-2", "cancelled"]
    assert stopped.landing_ns is None


def test_the_text_of_a_mission_loads_again_to_the_same_flight() -> None:
    found = mission(FORM, GO, LINE, LAND)
    again = scenario_from_text(found.text)
    assert again.file == found.file
    assert again.legs == found.legs


@pytest.mark.parametrize(
    ("legs", "keys", "message"),
    [
        ([], {}, r"mission\.legs: .*: expected at least one entry"),
        ([GO], {}, r"legs\[0\]\.kind: go_to: expected form"),
        ([FORM, FORM], {}, r"legs\[1\]\.kind: form: expected change"),
        ([FORM, {**GO, "at_s": 6}], {}, r"legs\[1\]\.at_s: 6 s: expected at least 7 s"),
        ([FORM, LAND, GO], {}, r"legs\[1\]\.kind: land: expected no leg after it"),
        ([FORM, {**GO, "at": "2026-11-22T12:00:09Z"}], {}, r"at: expected mission\.start"),
        ([FORM, {**GO, "at": "soon"}], {}, r"legs\[1\]\.at: \"soon\": expected a time in UTC"),
        (
            [FORM, {**GO, "at": "2026-11-22T12:00:09Z", "at_s": 9}],
            {"start": "2026-11-22T12:00:00Z"},
            r"expected either at or at_s",
        ),
        ([{**FORM, "on": "word"}], {}, r"legs\[0\]: expected no at_s, at or on"),
        ([FORM, {**GO, "name": "a"}, {**HOLD, "name": "a"}], {}, r"a: expected a name that no"),
        ([FORM, {"kind": "loop"}], {}, r"legs\[1\]\.kind: \"loop\": expected one of"),
        ([FORM, {**GO, "over_s": 0}], {}, r"legs\[1\]\.over_s: 0: expected >= 0\.1"),
        (
            [FORM, {**LINE, "shape": None, "offsets_m": {2: [0, 1, 0]}}],
            {},
            r"legs\[1\]\.offsets_m\.3: expected an offset of each follower",
        ),
        (
            [FORM, {"kind": "follow", "over_s": 3, "trajectory": UNTIMED}],
            {},
            r"legs\[1\]\.trajectory\.times_s: expected either times_s or speed_m_s",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_flown_is_refused(
    legs: list[dict[str, Any]], keys: dict[str, Any], message: str
) -> None:
    with pytest.raises(PtnsbcError, match=message):
        mission(*legs, **keys)


def test_legs_and_changes_do_not_mix() -> None:
    changes = {"formation.changes": [{"at_s": 9, "over_s": 2, "scale": [2, 1, 1]}]}
    with pytest.raises(PtnsbcError, match=r"expected none beside mission\.legs"):
        mission(FORM, GO).with_(changes)
