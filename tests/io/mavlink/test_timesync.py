"""The vehicle's clock: offsets from round trips, jumps, and vehicles that do not answer."""

import sys
import threading

import pytest

from ptnsbc_io.mavlink.timesync import TimeSync

BOOT_AT = 100.0  # the vehicle booted when our clock showed this


def trip(sync, sent_s, there_s, back_s, boot_at=BOOT_AT):
    """One question and its answer, with the time it took each way."""
    ours = sync.request(sent_s)
    theirs = round((sent_s + there_s - boot_at) * 1e9)
    return sync.on_answer(theirs, ours, sent_s + there_s + back_s)


def test_even_trips_give_the_offset():
    sync = TimeSync()
    assert trip(sync, 110.0, 0.002, 0.002)
    assert sync.to_host_time(11.0) == pytest.approx(111.0)
    assert sync.synchronised


def test_the_round_trip_may_be_asked_for_while_answers_come():
    """A bridge died of it in flight: the thread of its status asked when the thread of its link took an answer."""
    sync, over, before_s = TimeSync(), threading.Event(), sys.getswitchinterval()

    def answer():
        while not over.is_set():
            trip(sync, 110.0, 0.002, 0.002)

    answers = threading.Thread(target=answer)
    sys.setswitchinterval(1e-6)
    try:
        answers.start()
        assert {round(sync.round_trip_s, 6) for _ in range(20_000)} <= {0.0, 0.004}
    finally:
        over.set()
        answers.join()
        sys.setswitchinterval(before_s)


def test_the_quickest_trip_counts():
    sync = TimeSync()
    trip(sync, 110.0, 0.100, 0.001)
    assert sync.to_host_time(0.0) == pytest.approx(BOOT_AT - 0.0495)
    trip(sync, 111.0, 0.001, 0.001)
    trip(sync, 112.0, 0.001, 0.200)
    assert sync.to_host_time(0.0) == pytest.approx(BOOT_AT)
    assert sync.round_trip_s == pytest.approx(0.002)


def test_answers_to_nothing_and_repeated_answers_are_ignored():
    sync = TimeSync()
    assert not sync.on_answer(1, 2, 110.0)
    ours = sync.request(110.0)
    assert sync.on_answer(10 * 10**9, ours, 110.002)
    assert not sync.on_answer(99 * 10**9, ours, 110.004)
    assert sync.answers == 1


def test_a_jump_is_believed_when_it_stays():
    sync = TimeSync()
    trip(sync, 110.0, 0.001, 0.001)
    assert not trip(sync, 111.0, 0.001, 0.001, boot_at=90.0)  # once may be an accident
    assert sync.to_host_time(0.0) == pytest.approx(BOOT_AT)
    trip(sync, 112.0, 0.001, 0.001, boot_at=90.0)
    trip(sync, 113.0, 0.001, 0.001, boot_at=90.0)
    assert sync.to_host_time(0.0) == pytest.approx(90.0)


def test_single_accidents_never_add_up_to_a_jump():
    sync = TimeSync()
    for n in range(10):
        trip(sync, 110.0 + n, 0.001, 0.001)
        assert not trip(sync, 110.5 + n, 0.001, 0.001, boot_at=90.0)
    assert sync.to_host_time(0.0) == pytest.approx(BOOT_AT)


def test_without_answers_the_quickest_message_must_do():
    sync = TimeSync()
    assert sync.to_host_time(1.0) is None
    for n, late in enumerate((0.03, 0.01, 0.02, 0.05, 0.01, 0.01)):
        sync.on_boot_time(10.0 + n, BOOT_AT + 10.0 + n + late)
    assert not sync.synchronised
    assert not sync.ready(BOOT_AT + 14.0)
    assert sync.ready(BOOT_AT + 15.5)
    assert sync.to_host_time(10.0) == pytest.approx(BOOT_AT + 10.01)


def test_a_reboot_starts_again():
    sync = TimeSync()
    trip(sync, 110.0, 0.001, 0.001)
    sync.reset()
    assert sync.to_host_time(1.0) is None
