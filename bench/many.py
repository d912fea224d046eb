"""A fleet of twenty UAVs, recorded: lost messages, CPU of the recorder, megabytes a minute.

`run_fleet` flies it as `ptnsbc fleet` does: a process per UAV, all topics. Losses are the messages that processes
count as published, less those in the bag. In lock-step nothing is published before the flight, so all count. In real
time a message counts that was published after its process had received the first leg; the stamps in the bag tell which
these are. The outputs of a step have the stamp of its odometry, and two steps can use the same odometry. Where that
happens across the announcement of the leg, the later steps with that odometry do not count.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from bench.launch import BenchError
from bench.scenarios import grid
from bench.session import Plan, own_domain, print_progress
from bench.table import Row, Target
from bench.usage import Sampler
from ptnsbc_io.bag import Bag, read_bag
from ptnsbc_io.wire import (
    decode_diagnostics,
    decode_floats,
    decode_integers,
    peek_sequence_stamp,
    peek_stamp,
)
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import PublishCounters, sent_in
from ptnsbc_nodes.comm.topics import RECORDER
from ptnsbc_nodes.fleet.fleet import FleetOptions, FleetResult, run_fleet
from ptnsbc_nodes.uav.step_log import OWN, TickNote, tick_note

_UAVS = 20
_PATIENCE_S = 600.0  # the machine may be busy before what is measured begins


class Load(NamedTuple):
    """The options of a flight of the fleet."""

    name: str
    control_hz: int
    lockstep: bool


_LOADS = (Load("50 Hz in real time", 50, False), Load("100 Hz in lock-step", 100, True))


_MADE = (topics.TF.name,)  # by the recorder itself


_Since = Callable[[bytes], bool]
"""True if a message counts."""

_Counting = Callable[[str], tuple[_Since, int]]
"""Of a topic: which of its messages count, and how many of those sent do not."""


class Kept(NamedTuple):
    """Messages sent and recorded on one topic, or by one sender on a topic that many share."""

    name: str
    sent: int
    recorded: int


class Recorded(NamedTuple):
    """The recording of one flight, in numbers."""

    kept: tuple[Kept, ...]
    cores: float
    mb_per_min: float  # of flight
    steps_per_s: float  # by wall time, of each UAV


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    rows = []
    for load in _LOADS:
        print_progress(f"many: {_UAVS} UAVs, {load.name}")
        found = _fly(load, plan.of(20.0, 3.0))
        sent = sum(topic.sent for topic in found.kept)
        lost = sum(max(topic.sent - topic.recorded, 0) for topic in found.kept)
        what = f"recorder, {_UAVS} UAVs, {load.name}"
        rows += [
            Row(f"{what}: lost of {sent} messages", [float(lost)], "messages", target=Target(0.0)),
            Row(f"{what}: CPU", [found.cores], "cores"),
            Row(f"{what}: bag", [found.mb_per_min], "MB/min"),
            Row(f"{what}: the flight", [found.steps_per_s], "steps/s"),
        ]
    return rows


def _fly(load: Load, seconds: float) -> Recorded:
    scenario = grid(_UAVS, load.control_hz, seconds)
    with tempfile.TemporaryDirectory(prefix="bench-") as name, own_domain(), Sampler() as sampler:
        folder = Path(name)

        lines: list[str] = []

        def progress(line: str) -> None:
            lines.append(line)
            if line.endswith("started"):
                sampler.begin()

        options = FleetOptions(
            scenario,
            lockstep=load.lockstep,
            bag=folder / "bag",
            log_dir=folder / "logs",
            ready_timeout_s=_PATIENCE_S,
        )
        flown = run_fleet(options, progress)
        if flown.died or flown.interrupted:
            raise BenchError("\n".join([f"fleet of {_UAVS}:", *lines]))
        count = _kept_in_lockstep if load.lockstep else _kept_in_real_time
        kept = tuple(count(read_bag(folder / "bag"), _published(flown)))
        size = sum(file.stat().st_size for file in (folder / "bag").iterdir())
    for topic in kept:
        if topic.sent != topic.recorded:
            print_progress(f"many: {topic.name}: {topic.recorded} of {topic.sent}")
    steps = sum(topic.sent for topic in kept if topic.name.endswith("/setpoint/wrench"))
    return Recorded(
        kept,
        sampler.usage()[RECORDER].cores,
        size / 1e6 / (seconds / 60.0),
        steps / _UAVS / flown.flight_s,
    )


def _published(flown: FleetResult) -> dict[str, PublishCounters]:
    """The number of messages that each process has sent."""
    found = {}
    for process in flown.processes:
        if process.name != RECORDER:
            sent = sent_in(process.log.read_text(errors="replace").splitlines())
            if sent is None:
                raise BenchError(f"{process.log}: has no counts of sent messages")
            found[process.name] = sent
    return found


def _kept_in_lockstep(bag: Bag, published: Mapping[str, PublishCounters]) -> Iterator[Kept]:
    """By topic; `published` has the counters of each process by its name."""
    sent: Counter[str] = Counter()
    for one in published.values():
        sent.update(one.sent)
    for topic in bag.topics.values():
        if topic.name not in _MADE:
            yield Kept(topic.name, sent[topic.name], topic.messages)


def _kept_in_real_time(bag: Bag, published: Mapping[str, PublishCounters]) -> Iterator[Kept]:
    """By topic, of /diagnostics by process; `published` has the counters of each process by its name."""
    for process, one in published.items():
        uav = process.removeprefix("uav")
        counting = _of_uav(bag, int(uav), one) if uav.isdecimal() else _of_sim(one)
        for topic, sent in one.sent.items():
            after = sent - one.before[topic]
            if topic == topics.DIAGNOSTICS.name:
                yield Kept(f"{topic} of {process}", after, _diagnostics_of(bag, process, one))
            elif topic in bag.topics and topic not in (*_MADE, topics.EPOCH.name):
                since, left_out = counting(topic)
                recorded = sum(since(message.data) for message in bag.messages([topic]))
                yield Kept(topic, after - left_out, recorded)


def _diagnostics_of(bag: Bag, process: str, one: PublishCounters) -> int:
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
    """Messages of a step have the stamp of its odometry; the notes of the steps have their own."""
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
