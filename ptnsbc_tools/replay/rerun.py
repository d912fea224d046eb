"""Runs a bag through the controllers again: every step on its recorded inputs, every output compared.

The bag is read as a stream; memory does not grow with its length.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import signal
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import Bag, BagError
from ptnsbc_io.wire import WireError, decode_header, decode_odometry
from ptnsbc_nodes.comm import topics
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.verdict.recording import with_taken
from ptnsbc_tools.replay.drivers import LockstepDriver, RealTimeDriver, ReplayState
from ptnsbc_tools.replay.uav_replay import Account, Difference

Advance = Callable[[int, int], None]
Progress = Callable[[], AbstractContextManager[Advance]]
Accounts = dict[int, Account]  # by UAV

EQUAL, DIFFERENT, VOID = "equal", "different", "void"

_EVERY = 5000  # messages between two reports of progress


class RerunProcessError(PtnsbcError):
    """A process of the re-run ended without a result."""


def _no_progress() -> AbstractContextManager[Advance]:
    return nullcontext(lambda done, total: None)


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


def rerun(
    bag: Bag,
    scenario: Scenario,
    progress: Progress = _no_progress,
    jobs: int = 1,
) -> Rerun:
    """Re-run every step of every UAV of a flight of ours, in `jobs` processes.

    `progress` gives a function that is called now and then with the messages done and their total.

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
    bag: Bag,
    scenario: Scenario,
    uavs: Sequence[int],
    realtime: bool,
    progress: Progress = _no_progress,
) -> Accounts:
    """Re-run some of the UAVs."""
    state = ReplayState(scenario, uavs, bag.metadata.get("namespace", ""))
    driver = RealTimeDriver(state) if realtime else LockstepDriver(state)
    wanted = state.wanted(bag)
    total = sum(bag.topics[name].messages for name in wanted)
    with progress() as advance:  # after the fork: a progress bar has a thread
        for done, message in enumerate(bag.messages(wanted), start=1):
            if done % _EVERY == 0 or done == total:
                advance(done, total)
            try:
                state.put(message)
                if message.topic in driver.triggers:
                    driver.add(message.topic, message.stamp_ns, message.data)
            except WireError as error:
                raise BagError(f"{bag.path}: a message on {message.topic}: {error}") from None
        driver.make_until()
    return {uav: replay.account for uav, replay in state.uavs.items()}


def _in_parallel(parts: Sequence[Callable[[], Accounts]]) -> list[Accounts]:
    """The results of all parts: the first in this process, each other in a forked process.

    A forked process needs to load nothing.

    Raises:
        PtnsbcError: a part raised it, or a process was killed.
    """
    forked = multiprocessing.get_context("fork")
    others = []
    for part in parts[1:]:
        receiver, sender = forked.Pipe(duplex=False)
        process = forked.Process(target=_send, args=(part, sender), daemon=True)
        process.start()
        sender.close()
        others.append((process, receiver))
    try:
        return [parts[0](), *(_receive(receiver) for _, receiver in others)]
    finally:
        for process, receiver in others:
            process.kill()
            process.join()
            receiver.close()


def _send(part: Callable[[], Accounts], to: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # at Ctrl-C the first process ends the others
    result: Accounts | PtnsbcError
    try:
        result = part()
    except PtnsbcError as error:
        result = error
    to.send(result)


def _receive(receiver: Connection) -> Accounts:
    try:
        result: Accounts | PtnsbcError = receiver.recv()
    except EOFError:
        raise RerunProcessError("a process of the re-run has ended: was it killed?") from None
    if isinstance(result, PtnsbcError):
        raise result
    return result
