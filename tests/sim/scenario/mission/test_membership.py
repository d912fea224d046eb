"""Who leads and who follows whom when UAVs come and go: one rule, whatever the order in which they went."""

from functools import lru_cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.types import NEVER_RECEIVED_S
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.scenario.mission.membership import (
    Membership,
    View,
    changed,
    joins_ns,
    reconfigured,
)
from ptnsbc_sim.scenario.problems import ScenarioError

IDS = range(1, 8)
NOBODY: frozenset[int] = frozenset()


@lru_cache
def relay(vacancy: str = "keep") -> Scenario:
    return load_scenario("relay", {"formation.vacancy": vacancy})


def tree_of(scenario: Scenario | None) -> dict[int, int]:
    assert scenario is not None
    return dict(scenario.communication.tree)


def test_children_of_a_lost_uav_follow_the_one_above_it():
    found = reconfigured(relay(), Membership(frozenset({2}), NOBODY))
    assert tree_of(found) == {3: 1, 4: 1, 5: 3, 6: 4, 7: 5}
    assert found is not None and (4 in found.topology.pinned), "4 heard of the leader from it too"


def test_the_next_in_line_leads_from_its_own_slot():
    found = reconfigured(relay(), Membership(frozenset({1}), NOBODY))
    assert tree_of(found) == {3: 2, 4: 2, 5: 3, 6: 4, 7: 5}
    assert found is not None and found.leader.id == 2
    for uav in IDS:
        assert found.offset(uav).tolist() == relay().offset(uav).tolist()
    later = reconfigured(relay(), Membership(frozenset({1, 2}), NOBODY))
    assert later is not None and later.leader.id == 3


def test_who_was_away_takes_its_slot_but_neither_the_lead_nor_a_child():
    found = reconfigured(relay(), Membership(NOBODY, frozenset({1, 3})))
    assert found is not None and found.leader.id == 2
    assert tree_of(found) == {1: 2, 3: 2, 4: 2, 5: 2, 6: 4, 7: 5}


def test_nobody_leads_when_the_line_has_ended():
    assert reconfigured(relay(), Membership(frozenset({1, 2, 3}), NOBODY)) is None


def test_those_behind_an_empty_slot_move_up():
    found = reconfigured(relay("close_up"), Membership(frozenset({2}), NOBODY))
    assert found is not None and tree_of(found) == {4: 1, 3: 1, 5: 3, 6: 4, 7: 5}
    assert found.offset(4).tolist() == relay().offset(2).tolist()
    assert found.offset(6).tolist() == relay().offset(4).tolist()


def test_with_the_leader_gone_the_successor_takes_its_slot():
    found = reconfigured(relay("close_up"), Membership(frozenset({1}), NOBODY))
    assert found is not None and found.leader.id == 2 and not found.offset(2).any()
    assert found.offset(4).tolist() == relay().offset(2).tolist()


@given(
    st.sampled_from(["keep", "close_up"]),
    st.frozensets(st.sampled_from(IDS), max_size=5),
    st.frozensets(st.sampled_from(IDS), max_size=3),
)
def test_whoever_is_there_is_in_a_tree_below_one_leader(vacancy, absent, returned):
    base, members = relay(vacancy), Membership(absent, returned - absent)
    found = reconfigured(base, members)
    if {1, 2, 3} <= absent:
        assert found is None
        return
    assert found is not None
    there = set(IDS) - absent
    assert set(found.topology.order) == there, (
        "a tree of those who are there: checked as that of a file"
    )
    assert found.topology.lambda_min > 0.0 or len(there) == 1
    parents = set(tree_of(found).values())
    assert not parents & absent
    assert not parents & members.returned - {found.leader.id}
    places = {uav: tuple(found.offset(uav).tolist()) for uav in IDS}
    assert len(set(places.values())) == len(places)
    if vacancy == "close_up":
        slots = {tuple(base.offset(slot).tolist()): slot for slot in IDS}
        taken = {slots[places[uav]] for uav in there}
        above = base.communication.tree
        if found.leader.id == 1 or 1 in absent:
            assert all(above[slot] in taken for slot in taken if slot != 1), "no gap in any line"
    else:
        assert places == {uav: tuple(base.offset(uav).tolist()) for uav in IDS}


def test_silence_longer_than_stale_s_is_an_absence_and_is_remembered():
    view, fresh = View(relay(), 2), dict.fromkeys([1, 3, 4, 5, 6, 7], 0.01)
    late = joins_ns(relay(), 7)
    assert view.at(late, late, fresh) == (NOBODY, NOBODY)
    stale = {**fresh, 5: 0.51}
    assert view.at(late + 1, late + 1, stale) == (frozenset({5}), NOBODY)
    assert view.at(late + 2, late + 2, fresh) == (NOBODY, frozenset({5}))


def test_a_process_that_begins_anew_waits_before_it_misses_anybody():
    view = View(relay(), 5)
    nothing = dict.fromkeys([1, 2, 3, 4, 6, 7], NEVER_RECEIVED_S)
    now = 20_000_000_000
    assert view.at(now, 0, nothing) == (NOBODY, frozenset({5})), "it was away itself"
    later = view.at(now + 510_000_000, 510_000_000, nothing)
    assert later.absent == {1, 2, 3, 4, 6, 7}


def test_joiner_and_leaver_are_absent_by_plan():
    view, fresh = View(relay(), 2), dict.fromkeys([1, 3, 4, 5, 6, 7], 0.01)
    assert view.at(0, 0, fresh).absent == {7}
    assert view.at(31_000_000_000, 31_000_000_000, fresh) == (frozenset({6}), frozenset({7}))


def test_only_those_with_another_place_begin_anew():
    before, after = relay(), reconfigured(relay(), Membership(frozenset({2}), NOBODY))
    assert after is not None
    assert [uav for uav in (3, 4, 5, 6, 7) if changed(before, after, uav)[0]] == [4]


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"formation.vacancy": "wait"}, "uavs[6].joins_s: expected formation.vacancy"),
        ({"leader.successors": [1]}, "leader.successors[0]: 1: expected followers"),
        ({"leader.successors": [2, 2]}, "leader.successors[1]: 2"),
        ({"formation.assignment": "optimal"}, "expected formation.assignment: fixed"),
        ({"formation.frame": "heading"}, "expected a shape that does not move"),
        ({"formation.sight_m": 0.2}, "expected formation.sight_m: 0"),
    ],
)
def test_what_does_not_fit_is_refused(keys, text):
    with pytest.raises(ScenarioError) as error:
        load_scenario("relay", keys)
    assert text in str(error.value)
