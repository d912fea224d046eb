"""Runs a bag through the controllers again: every step on its recorded inputs, every output compared.

The bag is read as a stream; memory does not grow with its length.
"""

from __future__ import annotations

import dataclasses
import math
import multiprocessing
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import LEGS, MODE_FORMATION
from ptnsbc_io.bag import Bag, BagError, BagMessage
from ptnsbc_io.wire import (
    WireError,
    decode_diagnostics,
    decode_floats,
    decode_header,
    decode_integers,
    decode_odometry,
    peek_stamp,
)
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import DecidedSlots, keep_recorded
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_nodes.uav.step_log import TickNote, tick_note
from ptnsbc_nodes.uav.uav_controller import step_time
from ptnsbc_sim.disturbances.faults import gone
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.legs import number_of
from ptnsbc_sim.sweep.runner import depend_on_parent
from ptnsbc_sim.verdict.recording import with_taken
from ptnsbc_tools import console
from ptnsbc_tools.replay.uav_replay import (
    Account,
    Difference,
    Mismatch,
    MissingError,
    TopicBuffer,
    UavReplay,
    heard_topics,
)

_KEPT_SNAPSHOTS = 8


class ReplayState:
    """Buffered messages, epochs and UAVs of one re-run, or of a part of its UAVs."""

    def __init__(self, scenario: Scenario, uavs: Sequence[int], fleet: str = "") -> None:
        edges = CommunicationGraph(scenario, FlightOptions())
        self.scenario = scenario
        self.slots = DecidedSlots(scenario)
        self.uavs = {uav: UavReplay(scenario, uav, edges, self.slots, fleet) for uav in uavs}
        needed = {topic for uav in uavs for topic in topics.of_uav(uav)}
        for replay in self.uavs.values():
            needed.update(heard_topics(replay.senders))
        self.buffers = {topic.name: TopicBuffer(topic.type) for topic in needed}
        self.epochs = Epochs(scenario)
        self.first_t0_ns: int | None = None
        self._snapshots: dict[int, list[tuple[int, bytes]]] = {uav: [] for uav in uavs}
        self._snapshot_topics = {topics.snapshot(uav).name: uav for uav in uavs}

    def wanted(self, bag: Bag) -> list[str]:
        """Topics of a bag that a re-run reads."""
        ticks = [topics.tick(uav).name for uav in self.uavs]
        common = (topics.EPOCH.name, topics.SLOTS.name, topics.DIAGNOSTICS.name)
        names = (*self.buffers, *self._snapshot_topics, *ticks, *common)
        return [name for name in names if name in bag.topics]

    def put(self, message: BagMessage) -> None:
        """Keep a message until the steps that need it are made; WireError when it is broken."""
        buffer = self.buffers.get(message.topic)
        if buffer is not None:
            buffer.put(message.data)
        elif message.topic == topics.DIAGNOSTICS.name:
            for status in decode_diagnostics(message.data).statuses:
                name, _, kind = status.name.partition(": ")
                uav, ticks = name.removeprefix("uav")[:4], status.values.get("ticks", "")[:19]
                if kind == "planner" and uav.isdecimal() and ticks.isdecimal():
                    replay = self.uavs.get(int(uav))
                    if replay is not None:
                        replay.keep_counters(int(ticks), status.values)
        elif message.topic == topics.EPOCH.name:
            epoch = decode_header(message.data)
            word = number_of(epoch.frame_id) is not None
            if word or epoch.frame_id in LEGS:
                self.epochs.announce(epoch.stamp_ns, epoch.frame_id)
                if not word and self.first_t0_ns is None:
                    self.first_t0_ns = epoch.stamp_ns
        elif message.topic == topics.SLOTS.name:
            keep_recorded(self.slots, message.data)
        elif message.topic in self._snapshot_topics:
            numbers = decode_floats(message.data).values
            if not numbers.size or not np.isfinite(numbers[0]):
                raise WireError("snapshot without a number of its step")
            kept = self._snapshots[self._snapshot_topics[message.topic]]
            kept.append((int(numbers[0]), message.data))
            del kept[:-_KEPT_SNAPSHOTS]

    def snapshot(self, uav: int, sequence: int) -> bytes | None:
        """Remove and return the snapshot after step number `sequence`; None when there is none."""
        kept = self._snapshots[uav]
        for place, (number, data) in enumerate(kept):
            if number == sequence:
                del kept[: place + 1]
                return data
        return None

    def seconds(self, stamp_ns: int) -> float:
        """Time after the first epoch; after zero before an epoch is known."""
        return (stamp_ns - (self.first_t0_ns or 0)) * 1e-9


_WINDOW_NS = 1_000_000_000  # by how much later than a step its messages may be recorded
_KEPT_STAMPS = 2000  # per UAV: several seconds


class ReplayStep(NamedTuple):
    """A step as the flight counts it."""

    tick: int
    stamp_ns: int
    note: TickNote | None = None  # of real time


class Driver(ABC):
    """Makes the steps of all UAVs in the order of the recording.

    A step waits until all its messages have been read.
    """

    def __init__(self, state: ReplayState, trigger: Callable[[int], topics.Topic]) -> None:
        """`trigger`: the topic of a UAV whose messages stand for its steps."""
        self.state = state
        self.triggers = {trigger(uav).name: uav for uav in state.uavs}
        self._due: deque[tuple[int, int, ReplayStep]] = deque()  # log time, UAV, step

    @abstractmethod
    def read(self, uav: int, data: bytes) -> ReplayStep:
        """The step of a trigger."""

    @abstractmethod
    def make(self, replay: UavReplay, step: ReplayStep) -> Mismatch | None:
        """Make a step; returns what differs from the recording."""

    def add(self, topic: str, log_ns: int, data: bytes) -> None:
        """Take a trigger, and make the steps that were recorded `_WINDOW_NS` before it."""
        uav = self.triggers[topic]
        self._due.append((log_ns, uav, self.read(uav, data)))
        self.make_until(log_ns - _WINDOW_NS)

    def make_until(self, log_ns: float = math.inf) -> None:
        """Make the steps that were recorded before `log_ns`."""
        while self._due and self._due[0][0] < log_ns:
            _, uav, step = self._due.popleft()
            replay = self.state.uavs[uav]
            if replay.account.difference is not None:  # its controller state differs from there on
                continue
            replay.follow(self.state.epochs.scenario)
            try:
                found = self.make(replay, step)
            except WireError as error:
                found = Mismatch("an input", f"unreadable ({error})", "nothing")
            if found is not None:
                t_s = self.state.seconds(step.stamp_ns)
                difference = Difference(uav, step.tick, t_s, step.stamp_ns, *found)
                replay.account.difference = difference


class LockstepDriver(Driver):
    """Lock-step and headless bags: the rule of lock-step names the inputs of tick k (docs/lockstep.md).

    A step is the stamp of the UAV's own odometry.
    """

    def __init__(self, state: ReplayState) -> None:
        super().__init__(state, topics.odom)
        self._period_ns = state.scenario.timing.dt_ns
        self._near_every = state.scenario.near_every
        self._open_slots = state.scenario.formation.has_open_slots
        self._next_ns = dict.fromkeys(state.uavs, 0)
        self._gaps: dict[int, str] = {}  # why the steps of a UAV cannot be made any more
        dead = gone(state.scenario)
        self._gone = {uav: dead[:, row] for row, uav in enumerate(state.scenario.uav_ids)}

    def read(self, uav: int, data: bytes) -> ReplayStep:
        """Ticks are counted from simulated time 0; WireError when a stamp is no instant of it."""
        stamp_ns = peek_stamp(data)
        if stamp_ns % self._period_ns:
            raise WireError(
                f"stamp {stamp_ns} ns is no multiple of the period {self._period_ns} ns: expected "
                f"lock-step, or {topics.tick(uav).name} of real time in the bag"
            )
        return ReplayStep(stamp_ns // self._period_ns, stamp_ns)

    def make(self, replay: UavReplay, step: ReplayStep) -> Mismatch | None:
        """Make the step at a stamp from the messages of the tick before."""
        now_ns = step.stamp_ns
        leg = self.state.epochs.at(now_ns, replay.uav)
        if leg is None:
            return None
        if self._is_gone(replay.uav, now_ns, leg.first_t0_ns):
            self._next_ns[replay.uav] = now_ns + self._period_ns
            return None
        if self._is_gone(replay.uav, now_ns - self._period_ns, leg.first_t0_ns):
            replay.begin(None)  # another process
        replay.controller.inbox.begin(leg.first_t0_ns)
        why = self._gaps.get(replay.uav)
        if why is None:
            try:
                if self._open_slots and leg.mode == MODE_FORMATION:
                    replay.take_slot(leg.t0_ns)
                self._fetch(replay, now_ns)
            except MissingError as missing:
                why = str(missing)
                self._gaps[replay.uav] = why
        if why is not None:
            replay.account.skip(self.state.seconds(now_ns), 1, why)
            return None
        outputs = replay.step(step_time(now_ns, self._period_ns, leg, 0), now_ns)
        found = replay.compare(outputs, self.state.buffers)
        return found or replay.compare_counters()

    def _is_gone(self, uav: int, now_ns: int, t0_ns: int) -> bool:
        """True if the scenario has the process of a UAV killed, or not started again yet."""
        tick = (now_ns - t0_ns) // self._period_ns
        return 0 <= tick < len(self._gone[uav]) and bool(self._gone[uav][tick])

    def _fetch(self, replay: UavReplay, now_ns: int) -> None:
        expected_ns = self._next_ns[replay.uav]
        if now_ns != expected_ns:
            raise MissingError(f"{replay.inputs['own'].name} stamped {expected_ns} is not recorded")
        self._next_ns[replay.uav] = now_ns + self._period_ns
        tick = now_ns // self._period_ns
        last_near = (tick - tick % self._near_every) * self._period_ns
        for name, topic in replay.inputs.items():
            if name == "own":
                self._hold(replay, name, topic, now_ns)
            elif name == "near":
                self._hold(replay, name, topic, last_near)
            elif now_ns > 0:
                self._hold(replay, name, topic, now_ns - self._period_ns)

    def _hold(self, replay: UavReplay, name: str, topic: topics.Topic, due_ns: int) -> None:
        """Put in the message that is due; an older one only when its sender has ended."""
        buffer = self.state.buffers[topic.name]
        due = buffer.read(due_ns)
        if due:
            replay.hold(name, due[-1])
            return
        sender = int("".join(filter(str.isdigit, name)) or 0)
        first_ns = self.state.epochs.first_t0_ns or 0
        ended = sender and (buffer.newest_ns < due_ns or self._is_gone(sender, due_ns, first_ns))
        if not ended:
            raise MissingError(f"{topic.name} stamped {due_ns} is not recorded")
        last = buffer.before(due_ns)
        if last is not None:
            replay.hold(name, last)


class RealTimeDriver(Driver):
    """Real-time bags: each UAV recorded on `/uavN/tick` which messages went into each step.

    A step is such a note (`ptnsbc_nodes.uav.step_log`).
    """

    def __init__(self, state: ReplayState) -> None:
        super().__init__(state, topics.tick)
        self._sent: dict[int, dict[int, int]] = {uav: {} for uav in state.uavs}  # steps by stamp
        self._why = dict.fromkeys(state.uavs, "the recording begins after the first step")

    def read(self, uav: int, data: bytes) -> ReplayStep:
        """The note. All outputs of its step have the stamp of its own odometry."""
        row = decode_integers(data)
        note = tick_note(row.label, row.values.tolist())
        sent = self._sent[uav]
        own_ns = note.used["own"].stamp_ns
        sent[own_ns] = sent.get(own_ns, 0) + 1
        if len(sent) > _KEPT_STAMPS:
            del sent[next(iter(sent))]
        return ReplayStep(note.sequence, note.moment.now_ns, note)

    def make(self, replay: UavReplay, step: ReplayStep) -> Mismatch | None:
        """Make the step of a note, if the controller has made all steps before it."""
        note = step.note
        if note is None:  # a step of this driver has one
            return None
        snapshot = self.state.snapshot(replay.uav, note.sequence)
        if note.sequence == 0:  # the controller has started, or started again
            replay.begin(snapshot)
        expected = replay.next_step
        if expected != note.sequence:
            if expected is not None:
                self._why[replay.uav] = f"notes on {topics.tick(replay.uav).name} are not recorded"
                self._skip(replay, note, note.sequence - expected)
            self._leave_out(replay, note, snapshot)
            return None
        try:
            wrong = replay.fetch(note, self.state.buffers)
        except MissingError as missing:
            self._why[replay.uav] = str(missing)
            self._leave_out(replay, note, snapshot)
            return None
        outputs = replay.step(note.moment)
        expected = self._sent[replay.uav].get(note.used["own"].stamp_ns, 1)
        found = wrong or replay.compare(outputs, self.state.buffers, expected)
        found = found or replay.compare_counters()
        if found is None and snapshot is not None:
            found = replay.compare_snapshot(note.sequence, snapshot)
        return found

    def _leave_out(self, replay: UavReplay, note: TickNote, snapshot: bytes | None) -> None:
        """Do not make a step; continue after it if there is a snapshot."""
        self._skip(replay, note, 1)
        replay.reset()
        if snapshot is not None:
            replay.resume(note, snapshot)

    def _skip(self, replay: UavReplay, note: TickNote, steps: int) -> None:
        if note.moment.flying:
            t_s = self.state.seconds(note.moment.now_ns)
            replay.account.skip(t_s, steps, self._why[replay.uav])
        else:
            replay.account.waiting += steps


Accounts = dict[int, Account]  # by UAV

EQUAL, DIFFERENT, VOID = "equal", "different", "void"

_EVERY = 5000  # messages between two reports of progress


class Rerun(NamedTuple):
    """The result of a re-run."""

    realtime: bool
    flown_s: float  # length of the bag
    accounts: Accounts

    @property
    def first(self) -> Difference | None:
        """The first difference in the flight."""
        found = [one.difference for one in self.accounts.values() if one.difference is not None]
        return min(found, key=lambda one: one.stamp_ns, default=None)

    @property
    def verdict(self) -> str:
        """Worst of all UAVs: `different`, `void` when a part could not be compared, or `equal`."""
        if self.first is not None:
            return DIFFERENT
        accounts = self.accounts.values()
        holes = any(one.gaps or one.unrecorded or not one.compared for one in accounts)
        return VOID if holes else EQUAL

    def as_json(self, seconds: float) -> dict[str, Any]:
        """The result in plain types; `seconds` is the duration of the re-run."""
        return {
            "verdict": self.verdict,
            "mode": "real time" if self.realtime else "lock-step",
            "first_difference": None if self.first is None else dataclasses.asdict(self.first),
            "steps": sum(one.steps for one in self.accounts.values()),
            "compared": sum(one.compared for one in self.accounts.values()),
            "flown_s": self.flown_s,
            "took_s": seconds,
            "times_real_time": self.flown_s / seconds,
            "uavs": [
                {"uav": uav, **dataclasses.asdict(one), "gaps": [gap._asdict() for gap in one.gaps]}
                for uav, one in self.accounts.items()
            ],
        }


def rerun(bag: Bag, scenario: Scenario, progress: bool | None = False, jobs: int = 1) -> Rerun:
    """Re-run every step of every UAV of a flight of ours, in `jobs` processes; `progress` as of `console.progress`.

    Raises:
        PluginError: the scenario names a plug-in without its file: a bag carries no code.
        BagError: there is no step to re-run, or a message cannot be read.
    """
    scenario = _with_taken(bag, scenario)
    ticks = {topics.tick(uav).name for uav in scenario.uav_ids}
    realtime = any(topic.messages for topic in bag.topics.values() if topic.name in ticks)
    ids = scenario.uav_ids
    groups = [ids[k::jobs] for k in range(min(jobs, len(ids)))]
    parts = [partial(_accounts, bag, scenario, group, realtime) for group in groups]
    found: Accounts = {}
    for part in _in_parallel([partial(parts[0], progress=progress), *parts[1:]]):
        found |= part
    accounts = {uav: found[uav] for uav in ids}
    if not any(one.steps or one.gaps for one in accounts.values()):
        raise BagError(f"{bag.path}: no step to re-run: expected odometry and an epoch")
    return Rerun(realtime, (bag.end_ns - bag.start_ns) * 1e-9, accounts)


def _with_taken(bag: Bag, scenario: Scenario) -> Scenario:
    """The scenario with the setpoints that the leader has taken: each counts from its stamp on."""
    wanted = [name for name in (topics.TAKEN.name, topics.EPOCH.name) if name in bag.topics]
    epochs, taken = [], []
    for message in bag.messages(wanted) if len(wanted) == 2 else ():
        if message.topic == topics.EPOCH.name:
            epoch = decode_header(message.data)
            epochs.append((epoch.stamp_ns, epoch.frame_id))
        else:
            taken.append(decode_odometry(message.data))
    return with_taken(scenario, tuple(sorted(epochs)), taken)


def _accounts(
    bag: Bag, scenario: Scenario, uavs: Sequence[int], realtime: bool, progress: bool | None = False
) -> Accounts:
    state = ReplayState(scenario, uavs, bag.metadata.get("namespace", ""))
    driver = RealTimeDriver(state) if realtime else LockstepDriver(state)
    wanted = state.wanted(bag)
    total = sum(bag.topics[name].messages for name in wanted)
    # After the fork: a progress bar has a thread.
    with console.progress("re-running", progress) as advance:
        for done, message in enumerate(bag.messages(wanted), start=1):
            if done % _EVERY == 0 or done == total:
                advance(done, total)
            try:
                state.put(message)
                if message.topic in driver.triggers:
                    driver.add(message.topic, message.stamp_ns, message.data)
            except WireError as error:
                if message.topic != topics.DIAGNOSTICS.name:  # the verdict names those
                    raise BagError(f"{bag.path}: a message on {message.topic}: {error}") from None
        driver.make_until()
    return {uav: replay.account for uav, replay in state.uavs.items()}


def _in_parallel(parts: Sequence[Callable[[], Accounts]]) -> list[Accounts]:
    """The results of all parts: the first in this process, each other in a forked one, which needs to load nothing.

    Raises:
        PtnsbcError: a part raised it, or a process was killed.
    """
    forked, before = multiprocessing.get_context("fork"), multiprocessing.active_children()
    size = max(len(parts) - 1, 1)
    with ProcessPoolExecutor(size, mp_context=forked, initializer=depend_on_parent) as pool:
        try:
            others = [pool.submit(part) for part in parts[1:]]
            return [parts[0](), *(other.result() for other in others)]
        except BrokenProcessPool:
            raise PtnsbcError("a process of the re-run has ended: was it killed?") from None
        finally:  # after an error or Ctrl-C nobody waits for the other parts
            for process in set(multiprocessing.active_children()).difference(before):
                process.kill()
