"""Up to which stamp everything has been received, whatever comes late."""

import random

from ptnsbc_nodes.recording.completeness import Completeness

PERIODS = {"/a": 1, "/b": 1, "/c": 5, "/d": 20}


def test_nothing_is_complete_before_every_source_was_heard():
    received = Completeness(["/a", "/b"])
    assert not received.add("/a", 0)
    assert not received.add("/a", 1)
    assert received.add("/b", 0)
    assert received.complete_ns == 0


def test_a_rare_source_is_complete_up_to_its_next_message():
    received = Completeness(["/a", "/c"])
    for stamp in range(11):
        received.add("/a", stamp)
        if stamp % 5 == 0:
            received.add("/c", stamp)
    assert received.complete_ns == 10
    for stamp in range(11, 20):
        received.add("/a", stamp)
    assert received.complete_ns == 14  # the message of 15 is missing


def test_what_is_complete_has_arrived():
    """Each source in order, the sources up to 60 stamps apart: nothing comes at or below `complete_ns` any more."""
    for seed in range(30):
        draw = random.Random(seed)
        lag = {name: draw.randrange(60) for name in PERIODS}
        sent = [(stamp, name) for name, every in PERIODS.items() for stamp in range(0, 300, every)]
        received, left = Completeness(PERIODS), sorted(sent)
        for stamp, name in sorted(sent, key=lambda one: (one[0] + lag[one[1]], one[1])):
            assert stamp > received.complete_ns
            received.add(name, stamp)
            left.remove((stamp, name))
            assert all(other > received.complete_ns for other, _ in left)
        assert received.complete_ns >= 295


def test_a_lost_source_holds_nothing_back():
    received = Completeness(["/a", "/b"])
    for stamp in range(5):
        received.add("/a", stamp)
    assert received.complete_ns == -1
    assert received.lose("/b")
    assert received.complete_ns == 4
    assert not received.lose("/b")
    assert not received.add("/b", 9)
    assert received.add("/a", 5)


def test_a_source_that_is_not_awaited_changes_nothing():
    received = Completeness(["/a"])
    assert not received.add("/x", 3)
    assert received.complete_ns == -1
