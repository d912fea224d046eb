"""Which leg is in force when."""

import pytest

from ptnsbc_core.types import MODE_FORMATION, MODE_HOLD, MODE_LAND
from ptnsbc_nodes.comm.legs import EpochError, Epochs
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.mission.legs import CANCEL, Word, word_text

SCENARIO = load_scenario("paper_5")


def test_no_leg_before_its_epoch():
    epochs = Epochs(SCENARIO)
    assert epochs.at(0) is None
    epochs.announce(100, "form")
    assert epochs.announced
    assert epochs.at(99) is None
    assert epochs.at(100).mode == MODE_FORMATION


def test_each_leg_counts_from_its_own_epoch_and_knows_the_first():
    epochs = Epochs(SCENARIO)
    for t0, name in ((100, "form"), (500, "hold"), (900, "form")):
        epochs.announce(t0, name)
    assert epochs.at(499).name == "form"
    assert epochs.at(500) == ("hold", MODE_HOLD, 500, 100)
    assert epochs.at(2000) == ("form", MODE_FORMATION, 900, 100)


def test_a_stop_at_once_wins_over_a_hold_still_to_come():
    epochs = Epochs(SCENARIO)
    epochs.announce(100, "form")
    epochs.announce(700, "hold")
    epochs.announce(300, "land")
    assert epochs.at(300).mode == MODE_LAND
    assert epochs.at(800).mode == MODE_LAND


def test_what_the_latched_topic_repeats_changes_nothing():
    epochs = Epochs(SCENARIO)
    epochs.announce(100, "form")
    epochs.announce(100, "form")
    assert len(epochs._legs) == 1


def test_an_unknown_leg_is_refused_by_name():
    with pytest.raises(EpochError, match=r"'loop': expected one of form, hold, land"):
        Epochs(SCENARIO).announce(0, "loop")


LEGS = [
    {"kind": "form", "over_s": 4},
    {"kind": "go_to", "position_m": [2, 5, 6], "over_s": 4, "on": "word"},
    {"kind": "land", "over_s": 20},
]
S = 1_000_000_000


def flight(*legs):
    return load_scenario("paper_5_free", {"mission": {"legs": list(legs)}})


def test_the_mission_lands_by_itself():
    epochs = Epochs(flight(LEGS[0], LEGS[2]))
    epochs.announce(100, "form")
    assert epochs.at(4 * S + 99).name == "form"
    assert epochs.at(4 * S + 100) == ("land", MODE_LAND, 4 * S + 100, 100)
    epochs.announce(6 * S, "form")  # started again
    assert epochs.at(7 * S) == ("form", MODE_FORMATION, 6 * S, 100)


def test_who_holds_does_not_land_with_the_mission():
    epochs = Epochs(flight(LEGS[0], LEGS[2]))
    epochs.announce(100, "form")
    epochs.announce(2 * S, "hold")
    assert epochs.at(9 * S).name == "hold"


def test_a_word_begins_a_leg_and_what_follows_it():
    epochs = Epochs(flight(*LEGS))
    assert not epochs.announce(9 * S, word_text(2))  # before the first epoch it means nothing
    epochs.announce(1 * S, "form")
    assert epochs.announce(9 * S, word_text(2))
    assert not epochs.announce(9 * S, word_text(2))  # the latched topic may repeat it
    assert not epochs.announce(10 * S, word_text(4))  # there is no such leg
    assert epochs.scenario.words == (Word(2, 8.0),)
    assert epochs.at(12 * S).name == "form"
    assert epochs.at(13 * S).name == "land"
    assert epochs.announce(11 * S, word_text(CANCEL))
    assert epochs.at(14 * S).name == "form"
