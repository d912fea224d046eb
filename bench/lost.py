"""What a recorder lost: messages that processes say they published, against those in the bag.

In lock-step nothing is published before the flight, and all messages count. In real time those count that were
published after the process had heard of the first leg; the bag's own stamps tell which these are. What a step
sends is stamped like the odometry it was made of, and two steps can be made of the same one: where that happens
across the announcement, the steps after it that share that odometry count for nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from ptnsbc_io.bag import Bag
from ptnsbc_io.wire import decode_floats, decode_integers, peek_sequence_stamp, peek_stamp
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import PublishCounters
from ptnsbc_nodes.uav.step_log import OWN, TickNote, tick_note
from ptnsbc_tools.reading.diagnostics import decode_diagnostics

_MADE = (topics.TF.name,)  # by the recorder itself


_Since = Callable[[bytes], bool]
"""Whether a message counts."""

_Counting = Callable[[str], tuple[_Since, int]]
"""Of a topic: which of its messages count, and how many of those sent do not."""


class Kept(NamedTuple):
    """What became of the messages of one topic, or of one sender on a topic that many share."""

    name: str
    sent: int
    recorded: int


def in_lockstep(bag: Bag, told: Mapping[str, PublishCounters]) -> Iterator[Kept]:
    """By topic; `told` is what each process has sent, by its name."""
    sent: Counter[str] = Counter()
    for one in told.values():
        sent.update(one.sent)
    for topic in bag.topics.values():
        if topic.name not in _MADE:
            yield Kept(topic.name, sent[topic.name], topic.messages)


def in_real_time(bag: Bag, told: Mapping[str, PublishCounters]) -> Iterator[Kept]:
    """By topic, of /diagnostics by process; `told` is what each process has sent, by its name."""
    for process, one in told.items():
        uav = process.removeprefix("uav")
        counting = _of_uav(bag, int(uav), one) if uav.isdecimal() else _of_sim(one)
        for topic, sent in one.sent.items():
            after = sent - one.before[topic]
            if topic == topics.DIAGNOSTICS.name:
                yield Kept(f"{topic} of {process}", after, _said(bag, process, one))
            elif topic in bag.topics and topic not in (*_MADE, topics.EPOCH.name):
                since, left_out = counting(topic)
                recorded = sum(since(message.data) for message in bag.messages([topic]))
                yield Kept(topic, after - left_out, recorded)


def _said(bag: Bag, process: str, one: PublishCounters) -> int:
    found = (decode_diagnostics(m.data) for m in bag.messages([topics.DIAGNOSTICS.name]))
    return sum(
        a.stamp_ns > one.since_ns and a.statuses[0].name.startswith(f"{process}:") for a in found
    )


def _of_sim(one: PublishCounters) -> _Counting:
    """The sim stamps all by its own clock."""

    def counting(topic: str) -> tuple[_Since, int]:
        peek = peek_sequence_stamp if topic == topics.MARKERS.name else peek_stamp
        return lambda data: (peek(data) or 0) > one.since_ns, 0

    return counting


def _of_uav(bag: Bag, uav: int, one: PublishCounters) -> _Counting:
    """What a step sends has the stamp of the odometry it was made of, but for the notes of the steps themselves."""
    notes = [_note(m.data) for m in bag.messages([topics.tick(uav).name])]
    after = [note for note in notes if note.moment.now_ns > one.since_ns]
    before = [_made_of_ns(note) for note in notes if note.moment.now_ns <= one.since_ns]
    heard_ns = max(before, default=-1)
    shared = sum(_made_of_ns(note) <= heard_ns for note in after)

    def counting(topic: str) -> tuple[_Since, int]:
        if topic == topics.tick(uav).name:
            return lambda data: _note(data).moment.now_ns > one.since_ns, 0
        if topic == topics.snapshot(uav).name:
            return lambda data: bool(decode_floats(data).values[0] >= after[0].sequence), 0
        return lambda data: peek_stamp(data) > heard_ns, shared

    return counting


def _made_of_ns(note: TickNote) -> int:
    return note.used[OWN].stamp_ns


def _note(data: bytes) -> TickNote:
    row = decode_integers(data)
    return tick_note(row.label, row.values.tolist())
