"""Whatever the order of arrival, the same order comes out."""

from __future__ import annotations

import random

import pytest

from ptnsbc_io.bag.reorder import PendingMessage, ReorderBuffer

TOPICS = ("/a", "/b", "/shared")


def flight(ticks: int) -> list[tuple[int, str, bytes]]:
    return [
        (tick, topic, f"{topic}{tick}{part}".encode())
        for tick in range(ticks)
        for topic in TOPICS
        for part in range(2)
    ]


def run(messages, **options) -> tuple[list[tuple[int, str, bytes]], int]:
    order = ReorderBuffer(frozenset({"/shared"}), **options)
    out: list[PendingMessage] = []
    for message in messages:
        order.push(*message)
        out += order.release()
    out += order.flush()
    return [(held.stamp_ns, held.topic, held.data) for held in out], order.late


def shuffled(messages, seed: int, window: int):
    """Order within a single-publisher topic kept; across topics up to `window` ticks apart."""
    rng = random.Random(seed)
    lag = {topic: rng.randrange(window) for topic in TOPICS}

    def key(item):
        position, (tick, topic, _) = item
        chance = rng.random() if topic == "/shared" else 0.0
        return (tick + lag[topic], rng.random() * 0 + TOPICS.index(topic), chance, position)

    return [message for _, message in sorted(enumerate(messages), key=key)]


@pytest.mark.parametrize("seed", range(20))
def test_same_out_whatever_in(seed):
    messages = flight(100)
    assert run(shuffled(messages, seed, 20)) == (messages, 0)


def test_arrival_order_is_kept_within_a_topic():
    messages = [(5, "/a", b"z"), (5, "/a", b"a")]
    assert run(messages)[0] == messages


def test_shared_topic_is_ordered_by_content():
    assert run([(5, "/shared", b"z"), (5, "/shared", b"a")])[0] == [
        (5, "/shared", b"a"),
        (5, "/shared", b"z"),
    ]


def test_a_stamp_far_ahead_pushes_nothing_out():
    out, late = run([(10**9, "/a", b""), *flight(10)])
    assert late == 0
    assert out == [*flight(10), (10**9, "/a", b"")]


def test_late_messages_are_kept_and_counted():
    out, late = run([(k, "/a", b"") for k in range(30)] + [(0, "/b", b"late")])
    assert late == 1
    assert (0, "/b", b"late") in out


def test_the_oldest_stamp_waits_for_no_later_one_where_it_is_complete():
    order = ReorderBuffer()
    assert not order.first()
    order.complete_ns = -1
    for message in ((2, "/a", b""), (0, "/b", b""), (1, "/a", b""), (0, "/a", b"")):
        order.push(*message)
        assert not order.release()
    assert not order.first()
    order.complete_ns = 1
    assert [(held.stamp_ns, held.topic) for held in order.first()] == [(0, "/a"), (0, "/b")]
    assert [held.stamp_ns for held in order.flush()] == [1, 2]
    assert order.late == 0
