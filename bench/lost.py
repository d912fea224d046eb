"""What a recorder lost: messages that processes say they published, against those in the bag.

In lock-step nothing is published before the flight, and all messages count. In real time those count that were
published after the process had heard of the first leg; the bag's own stamps tell which these are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from ptnsbc_nodes import topics
from ptnsbc_nodes.bag import Bag
from ptnsbc_nodes.endpoints import Sent
from ptnsbc_nodes.ticklog import OWN, TickNote, tick_note
from ptnsbc_nodes.wire import decode_floats, decode_integers, peek_sequence_stamp, peek_stamp
from ptnsbc_tools.diagnostics import decode_diagnostics

_MADE = (topics.TF.name,)  # by the recorder itself


class Kept(NamedTuple):
    """What became of the messages of one topic, or of one sender on a topic that many share."""

    name: str
    sent: int
    recorded: int


def in_lockstep(bag: Bag, told: Mapping[str, Sent]) -> Iterator[Kept]:
    """By topic; `told` is what each process has sent, by its name."""
    sent: Counter[str] = Counter()
    for one in told.values():
        sent.update(one.sent)
    for topic in bag.topics.values():
        if topic.name not in _MADE:
            yield Kept(topic.name, sent[topic.name], topic.messages)


def in_real_time(bag: Bag, told: Mapping[str, Sent]) -> Iterator[Kept]:
    """By topic, of /diagnostics by process; `told` is what each process has sent, by its name."""
    for process, one in told.items():
        uav = process.removeprefix("uav")
        counts = _of_uav(bag, int(uav), one) if uav.isdecimal() else _of_sim(one)
        for topic, sent in one.sent.items():
            if topic == topics.DIAGNOSTICS.name:
                yield Kept(
                    f"{topic} of {process}", sent - one.before[topic], _said(bag, process, one)
                )
            elif topic in bag.topics and topic not in (*_MADE, topics.EPOCH.name):
                recorded = sum(counts(topic, message.data) for message in bag.messages([topic]))
                yield Kept(topic, sent - one.before[topic], recorded)


def _said(bag: Bag, process: str, one: Sent) -> int:
    found = (decode_diagnostics(m.data) for m in bag.messages([topics.DIAGNOSTICS.name]))
    return sum(
        a.stamp_ns > one.since_ns and a.statuses[0].name.startswith(f"{process}:") for a in found
    )


def _of_sim(one: Sent) -> Callable[[str, bytes], bool]:
    """Whether a message counts: the sim stamps all by its own clock."""

    def counts(topic: str, data: bytes) -> bool:
        peek = peek_sequence_stamp if topic == topics.MARKERS.name else peek_stamp
        return (peek(data) or 0) > one.since_ns

    return counts


def _of_uav(bag: Bag, uav: int, one: Sent) -> Callable[[str, bytes], bool]:
    """Whether a message counts: it belongs to the first step after the announcement, or to a later one.

    What a step sends is stamped like the odometry it was made of. Two steps are never made of the same one
    there, or the first of them would be counted too.
    """
    notes = [_note(m.data) for m in bag.messages([topics.tick(uav).name])]
    first = next(note for note in notes if note.moment.now_ns > one.since_ns)
    made_of_ns = first.used[OWN].stamp_ns

    def counts(topic: str, data: bytes) -> bool:
        if topic == topics.tick(uav).name:
            return _note(data).moment.now_ns > one.since_ns
        if topic == topics.snapshot(uav).name:
            return bool(decode_floats(data).values[0] >= first.sequence)
        return peek_stamp(data) >= made_of_ns

    return counts


def _note(data: bytes) -> TickNote:
    row = decode_integers(data)
    return tick_note(row.label, row.values.tolist())
