"""When the legs of a mission begin, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.timebase import h
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.scenario.mission.legs import CANCEL, Word, utc_time
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.scenario.scenario import scenario_from_text

FORM = {"kind": "form", "over_s": 6, "stay_s": 1}
GO = {"kind": "go_to", "position_m": [4, 0, 6], "over_s": 5}
LINE = {"kind": "change", "shape": {"kind": "line", "spacing_m": 2}, "over_s": 4}
HOLD = {"kind": "hold", "over_s": 3}
UNTIMED = {"kind": "waypoints", "points_m": [[0, 0, 1], [1, 0, 1]]}
LAND = {"kind": "land", "over_s": 20}
RISE = {"kind": "take_off", "height_m": 5, "over_s": 4, "stay_s": 1}


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
    assert [one.at_s for one in found.formation.changes] == [0.0, 20.0]


def test_the_first_leg_says_deadline_shape_and_slots() -> None:
    first = {**FORM, "shape": {"kind": "column", "spacing_m": 3}, "slots": "optimal"}
    found = mission(first)
    assert found.gains.formation.deadline_s == 6.0
    assert found.offset(2).tolist() == [-3, 0, 0]
    assert found.formation.assignment == "optimal"


def test_the_first_leg_may_say_offsets_and_trajectory() -> None:
    circle = {"kind": "circle", "centre_m": [0, 0, 5], "radius_m": 5, "rate_rad_s": 0.1}
    places = {2: [1, 0, 0], 3: [2, 0, 0], 4: [3, 0, 0], 5: [4, 0, 0]}
    found = mission({**FORM, "trajectory": circle, "offsets_m": places})
    assert found.offset(4).tolist() == [3, 0, 0]
    assert reference(leader_trajectory(found), 0.0).position == pytest.approx([0, 5, 5])


def starts(scenario: Scenario) -> Array:
    return np.array([scenario.uav(uav).position for uav in scenario.uav_ids])


def places(scenario: Scenario, t: float) -> Array:
    """Places (N, 3) [m] of all UAVs in the world."""
    lead = np.array(reference(leader_trajectory(scenario), t).position)
    now = np.array([t])
    return np.array([lead + places_beside_leader(scenario, u, now)[0] for u in scenario.uav_ids])


def test_a_take_off_rises_straight_up_over_the_starts() -> None:
    """From rest to rest by the time profile of the method, whatever the heights of the starts are."""
    found = mission(RISE, FORM, LAND).with_({"uavs[2].position_m": [-1, 0, 0.4]})
    begin = starts(found)
    assert places(found, 0.0) == pytest.approx(begin, abs=1e-12)
    for t in (1.0, 2.0, 3.0, 4.0, 5.0):
        assert places(found, t)[:, :2] == pytest.approx(begin[:, :2], abs=1e-12)
    assert places(found, 4.0)[:, 2] == pytest.approx([5] * 5)
    lead = begin[0, 2] + h(0.25) * (5 - begin[0, 2])
    assert places(found, 1.0)[0, 2] == pytest.approx(lead)
    assert found.gains.formation.deadline_s == 4.0
    assert times(found) == [(0, 4, 5), (5, 11, 12), (12, 32, 32)]


def test_after_the_take_off_the_formation_comes_about_on_the_trajectory() -> None:
    form = {**FORM, "shape": {"kind": "v", "spacing_m": 2}}
    found, without = mission(RISE, form, GO), mission(form)
    assert places(found, 11.0) == pytest.approx(places(without, 6.0), abs=1e-6)
    assert places(found, 12.0) == pytest.approx(places(without, 7.0), abs=1e-6)
    assert found.with_words([Word(CANCEL, 2.0)]).legs[-1].name == "cancelled"


def test_slots_are_decided_by_the_starts_of_a_take_off() -> None:
    crossed = {2: [2, 0, 0], 3: [-2, 0, 0], 4: [-2, 2, 0], 5: [-2, -2, 0]}
    first = {**FORM, "offsets_m": crossed}
    begin = {f"uavs[{k}].position_m": [2.0 * k if k != 1 else -2.0, 0, 0] for k in range(5)}
    fixed, free = (
        mission(RISE, {**first, "slots": one}).with_(begin) for one in ("fixed", "optimal")
    )
    leader = places(fixed, 10.9)[0]
    assert places(fixed, 11.0)[1] - leader == pytest.approx([2, 0, 0], abs=0.2)
    assert places(free, 11.0)[1] - leader == pytest.approx([-2, 0, 0], abs=0.2)
    assert free.formation.assignment == "fixed"


def test_the_take_off_of_real_vehicles_begins_where_their_own_ends() -> None:
    found = load_scenario("take_off_4").bridged()
    assert found.bridged().text == found.text
    assert places(found, 0.0)[:, 2] == pytest.approx([3.0] * 4)
    assert places(found, 6.0)[:, 2] == pytest.approx([5.0] * 4)
    own = mission({**RISE, "from_m": 2}, FORM)
    assert own.bridged() is own


def test_the_text_of_a_take_off_loads_again_to_the_same_flight() -> None:
    found = mission(RISE, {**FORM, "shape": {"kind": "v", "spacing_m": 2}}, LINE, LAND)
    again = scenario_from_text(found.text)
    assert again == found
    assert again.legs == found.legs


def test_times_in_utc_count_from_the_start_of_the_mission() -> None:
    leg = {**GO, "at": "2026-11-22T12:00:09.5Z"}
    found = mission(FORM, leg, start="2026-11-22T12:00:00Z")
    assert found.legs[1].begin_s == 9.5
    every_minute = mission(FORM, {**GO, "at": "*:*:05.5Z"}, start="*:*:56Z")
    assert every_minute.legs[1].begin_s == 9.5


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
    assert again == found
    assert again.legs == found.legs


@pytest.mark.parametrize(
    ("legs", "keys", "message"),
    [
        ([], {}, r"mission\.legs: .*: expected at least one entry"),
        ([GO], {}, r"legs\[0\]\.kind: go_to: expected form or take_off"),
        ([FORM, RISE], {}, r"legs\[1\]\.kind: take_off: expected no take_off after the first"),
        ([RISE, GO], {}, r"legs\[1\]\.kind: go_to: expected form, which follows take_off"),
        ([RISE, FORM, FORM], {}, r"legs\[2\]\.kind: form: expected change"),
        ([FORM, FORM], {}, r"legs\[1\]\.kind: form: expected change"),
        ([FORM, {**GO, "at_s": 6}], {}, r"legs\[1\]\.at_s: 6 s: expected at least 7 s"),
        ([FORM, LAND, GO], {}, r"legs\[1\]\.kind: land: expected no leg after it"),
        ([FORM, {**GO, "at": "2026-11-22T12:00:09Z"}], {}, r"at: expected mission\.start"),
        ([FORM, {**GO, "at": "soon"}], {}, r"legs\[1\]\.at: \"soon\": expected a time in UTC"),
        (
            [FORM, {**GO, "at": "12:00:09Z"}],
            {"start": "*:*:00Z"},
            r"legs\[1\]\.at: 12:00:09Z: expected a time that recurs as mission\.start, \*:\*:00Z",
        ),
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
    with pytest.raises(PtnsbcError, match=r"changes: expected none beside mission\.legs"):
        mission(FORM, GO).with_(changes)


NOON_NS = 1_795_348_800_000_000_000  # 2026-11-22T12:00:00Z
SECOND_NS = 1_000_000_000


def test_an_instant_is_the_same_whenever_it_is_asked_for() -> None:
    found = utc_time("2026-11-22T12:00:00.5Z")
    assert found == (NOON_NS + SECOND_NS // 2, 0)
    assert found.next_ns(0) == found.next_ns(2 * NOON_NS) == found.first_ns


@pytest.mark.parametrize(
    ("text", "late_s"), [("12:00:07.25Z", 86_400), ("*:00:07.25Z", 3600), ("*:*:07.25Z", 60)]
)
def test_a_time_that_recurs_is_the_first_one_from_now_on(text: str, late_s: int) -> None:
    at_ns = NOON_NS + 7 * SECOND_NS + SECOND_NS // 4
    found = utc_time(text)
    assert found.next_ns(NOON_NS) == found.next_ns(at_ns) == at_ns
    assert found.next_ns(at_ns + 1) == at_ns + late_s * SECOND_NS


@pytest.mark.parametrize(
    ("start", "at", "after_s"),
    [
        ("2026-11-22T12:00:00Z", "2026-11-22T12:00:09.5Z", 9.5),
        ("2026-11-22T12:00:00Z", "*:*:09Z", 9),
        ("23:59:50Z", "00:00:05Z", 15),
        ("*:59:50Z", "*:00:05Z", 15),
        ("12:00:50Z", "*:*:05Z", 15),
    ],
)
def test_the_time_from_one_to_the_first_of_another(start: str, at: str, after_s: float) -> None:
    first, then = utc_time(start), utc_time(at)
    assert then.follows(first)
    assert then.after(first) == round(after_s * SECOND_NS)


@pytest.mark.parametrize(
    ("start", "at"),
    [("12:00:00Z", "2026-11-22T12:00:09Z"), ("*:*:00Z", "*:00:09Z"), ("*:00:00Z", "12:00:09Z")],
)
def test_a_rarer_time_has_no_one_distance_from_one_that_recurs(start: str, at: str) -> None:
    assert not utc_time(at).follows(utc_time(start))


@pytest.mark.parametrize(
    "text",
    ["soon", "12:00:05", "24:00:00Z", "12:*:05Z", "*:*:*Z", "*:*:60Z", "1700000000", "Z", "*:*:5Z"],
)
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        utc_time(text)
