"""Which leg is in force when."""

import pytest

from ptnsbc_core.types import MODE_FORMATION, MODE_HOLD, MODE_LAND
from ptnsbc_nodes.comm.legs import EpochError, Epochs


def test_no_leg_before_its_epoch():
    epochs = Epochs()
    assert epochs.at(0) is None
    epochs.announce(100, "form")
    assert epochs.announced
    assert epochs.at(99) is None
    assert epochs.at(100).mode == MODE_FORMATION


def test_each_leg_counts_from_its_own_epoch_and_knows_the_first():
    epochs = Epochs()
    for t0, name in ((100, "form"), (500, "hold"), (900, "form")):
        epochs.announce(t0, name)
    assert epochs.at(499).name == "form"
    assert epochs.at(500) == ("hold", MODE_HOLD, 500, 100)
    assert epochs.at(2000) == ("form", MODE_FORMATION, 900, 100)


def test_a_stop_at_once_wins_over_a_hold_still_to_come():
    epochs = Epochs()
    epochs.announce(100, "form")
    epochs.announce(700, "hold")
    epochs.announce(300, "land")
    assert epochs.at(300).mode == MODE_LAND
    assert epochs.at(800).mode == MODE_LAND


def test_what_the_latched_topic_repeats_changes_nothing():
    epochs = Epochs()
    epochs.announce(100, "form")
    epochs.announce(100, "form")
    assert len(epochs._legs) == 1


def test_an_unknown_leg_is_refused_by_name():
    with pytest.raises(EpochError, match=r"'loop': expected one of form, hold, land"):
        Epochs().announce(0, "loop")


def test_the_mission_lands_by_itself():
    epochs = Epochs(landing_ns=600)
    epochs.announce(100, "form")
    assert epochs.at(699).name == "form"
    assert epochs.at(700) == ("land", MODE_LAND, 700, 100)
    epochs.announce(800, "form")  # started again
    assert epochs.at(900) == ("form", MODE_FORMATION, 800, 100)


def test_who_holds_does_not_land_with_the_mission():
    epochs = Epochs(landing_ns=600)
    epochs.announce(100, "form")
    epochs.announce(500, "hold")
    assert epochs.at(900).name == "hold"
