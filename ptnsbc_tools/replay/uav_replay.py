"""One UAV in a re-run: its recorded inputs through its own control step, its outputs beside the recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from ptnsbc_core.agent import Agent, PackedOutputs
from ptnsbc_core.types import ODOMETRY_SIZE, AgentConfig, AgentState
from ptnsbc_io.wire import Stamped, WireError, decode_floats
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import AgentMessages
from ptnsbc_nodes.comm.graph import Senders
from ptnsbc_nodes.uav.controller import StepTime, UavController, VehicleSpeedLimits
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS, Inbox
from ptnsbc_nodes.uav.step_log import (
    ControllerSnapshot,
    SnapshotTemplate,
    TickNote,
    checksum,
    decode_snapshot,
    sources,
)
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_tools.replay.difference import (
    Difference,
    Mismatch,
    of_messages,
    of_numbers,
    of_texts,
)
from ptnsbc_tools.replay.topic_buffer import TopicBuffer

_SENSORS = ("own", "near")
OUTPUTS = ("formation_state", "leader_estimate", "setpoint/velocity", "setpoint/wrench")


class Gap(NamedTuple):
    """Steps that could not be re-run."""

    first_s: float  # after the epoch
    last_s: float
    steps: int
    reason: str


class MissingError(Exception):
    """A message that a step was made of is not in the recording."""


@dataclass
class Account:
    """What a re-run found out about one UAV."""

    steps: int = 0  # re-run
    compared: int = 0  # outputs, counters and snapshots
    waiting: int = 0  # steps before the first leg that were not re-run: nothing is promised there
    silent: int = 0  # steps for which nothing of this UAV is recorded
    unrecorded: int = 0  # single outputs that are not in the recording
    difference: Difference | None = None
    gaps: list[Gap] = field(default_factory=list)

    def skip(self, t_s: float, steps: int, reason: str) -> None:
        """Count steps that could not be re-run."""
        if self.gaps and self.gaps[-1].reason == reason:
            last = self.gaps.pop()
            self.gaps.append(Gap(last.first_s, t_s, last.steps + steps, reason))
        else:
            self.gaps.append(Gap(t_s, t_s, steps, reason))


def source_topics(uav: int, senders: Senders) -> dict[str, topics.Topic]:
    """Where each of a UAV's inputs is recorded."""
    known = {"own": topics.odom(uav), "near": topics.near(uav)}
    known |= {f"state{i}": topics.formation_state(i) for i in senders.states}
    known |= {f"estimate{i}": topics.leader_estimate(i) for i in senders.estimators}
    return {name: known[name] for name in sources(senders)}


class UavReplay:
    """A pilot, and what its UAV said."""

    def __init__(self, scenario: Scenario, uav: int, senders: Senders) -> None:
        self.uav = uav
        self.senders = senders
        self.account = Account()
        self.inputs = source_topics(uav, senders)
        self.outputs = [f"/uav{uav}/{name}" for name in OUTPUTS]
        self.told: dict[int, list[dict[str, str]]] = {}  # counters of /diagnostics by their ticks
        self._config = agent_config(scenario, uav)
        self.pilot = UavController(self._config, senders)
        self._put = _places(self.pilot.inbox)
        self._letters = AgentMessages(uav)
        self._next: int | None = None  # number of the step that the pilot is ready for
        self._held: dict[str, Stamped] = {}
        self._snapshot: SnapshotTemplate | None = None

    @property
    def next_step(self) -> int | None:
        """Number of the step that the pilot is ready for; None: it has missed one."""
        return self._next

    def begin(self, snapshot: bytes | None) -> None:
        """The controller begins, or begins anew: it remembers nothing; its limits are in its first snapshot."""
        limits = None if snapshot is None else self._recalled(snapshot).limits
        self.lose_thread(limits)
        self._next = 0

    def lose_thread(self, limits: VehicleSpeedLimits | None = None) -> None:
        """A step was left out: only a snapshot helps."""
        self._next = None
        self._held.clear()
        config = self._config if limits is None else limits.applied_to(self._config)
        self.pilot = UavController(config, self.senders)
        self._put = _places(self.pilot.inbox)

    def resume(self, sequence: int, snapshot: bytes) -> None:
        """Go on behind the step of a snapshot."""
        memory = self._recalled(snapshot)
        self.lose_thread(memory.limits)
        self.pilot.resume(memory.state, memory.counters)
        self._next = sequence + 1

    def _recalled(self, snapshot: bytes) -> ControllerSnapshot:
        row = decode_floats(snapshot)
        numbers = np.asarray(row.values, dtype=np.float64)
        return decode_snapshot(row.label, numbers, like=_any_state(self._config))

    def hold(self, name: str, message: Stamped) -> None:
        """Put a message where the process had it."""
        if self._held.get(name) is not message:
            self._held[name] = message
            self._put[name](message)

    def fetch(self, note: TickNote, shelves: Mapping[str, TopicBuffer]) -> Mismatch | None:
        """Put what a real-time step was made of into the inbox; the first sensor message that is another one.

        A UAV that ticks twice on one odometry sends two messages with one stamp. Where none of those
        recorded is the one that was used, that one is missing: a message of another UAV that was
        changed is found where that UAV is compared.
        """
        wrong = None
        for name, used in note.used.items():
            held = self._held.get(name)
            if held is not None and used == (held.stamp_ns, checksum(held)):
                continue
            if name not in self.inputs:
                raise WireError(
                    f"a step was made of {name}, whom it does not hear in this scenario"
                )
            topic = self.inputs[name].name
            found = shelves[topic].read(used.stamp_ns)
            same = [message for message in found if checksum(message) == used.checksum]
            if not same and (not found or name not in _SENSORS):
                raise MissingError(f"{topic} stamped {used.stamp_ns} was used and is not recorded")
            if not same:
                wrong = wrong or Mismatch(
                    f"{topic}, an input stamped {used.stamp_ns}",
                    f"checksum {checksum(found[-1]):08x} in the bag",
                    f"{used.checksum:08x} noted by the UAV",
                )
            self.hold(name, (same or found)[-1])
        return wrong

    def step(self, at: StepTime, cutoff_ns: int = NO_CUTOFF_NS) -> PackedOutputs:
        """One control step on what is in the inbox."""
        self.account.steps += 1
        if self._next is not None:
            self._next += 1
        return self.pilot.step(at, cutoff_ns)

    def compare(
        self,
        outputs: PackedOutputs,
        shelves: Mapping[str, TopicBuffer],
        expected: int | None = None,
    ) -> Mismatch | None:
        """The first output that differs.

        Args:
            outputs: what the step gave.
            shelves: what is recorded.
            expected: messages that carry the stamp of this step, where it may be several; after the
                last of them that is recorded more may have been on their way.
        """
        own = self.pilot.inbox.own
        if own is None:  # a step was made of it
            raise WireError("no own odometry")
        recorded = [shelves[name].at(own.stamp_ns) for name in self.outputs]
        if not any(recorded):
            self.account.silent += 1
            return None
        # Silent at the end is a process that has ended; silent in between is a hole.
        self.account.unrecorded += len(OUTPUTS) * self.account.silent
        self.account.silent = 0
        made = self._letters.all(own, outputs)
        for name, found, computed in zip(OUTPUTS, recorded, made, strict=True):
            if len(computed) % 4:  # as DDS hands it over
                computed += bytes(-len(computed) % 4)
            if computed in found:
                self.account.compared += 1
            elif not found or self._may_lack(shelves[f"/uav{self.uav}/{name}"], found, expected):
                self.account.unrecorded += 1
            else:
                return of_messages(name, found[0], computed)
        return None

    @staticmethod
    def _may_lack(shelf: TopicBuffer, found: list[bytes], expected: int | None) -> bool:
        if expected is None:
            return False
        return len(found) < expected or found is shelf.at(shelf.newest_ns)

    def compare_counters(self) -> Mismatch | None:
        """The first counter that /diagnostics told differently at this number of steps."""
        told = self.told.pop(self.pilot.counters.ticks, None)
        if told is None:
            return None
        own = self.pilot.counters.values()
        for values in told:
            for key, computed in own.items():
                recorded = values.get(key)
                if recorded != computed:
                    return of_texts(f"diagnostics {key}", recorded, computed)
            self.account.compared += 1
        return None

    def compare_snapshot(self, sequence: int, data: bytes) -> Mismatch | None:
        """The first number of the controller's memory that differs."""
        self._snapshot = self._snapshot or SnapshotTemplate(self.pilot)
        made = self._snapshot.encode(sequence, self.pilot)
        if made == data[: len(made)]:
            self.account.compared += 1
            return None
        found, own = decode_floats(data), decode_floats(made)
        if found.label != own.label:
            return Mismatch("snapshot", found.label, own.label)
        names = [
            f"{word.partition(':')[0]}[{k}]"
            for word in own.label.split()
            for k in range(int(word.partition(":")[2]))
        ]
        for name, recorded, computed in zip(names, found.values, own.values, strict=True):
            if recorded.tobytes() != computed.tobytes():
                return of_numbers(f"snapshot {name}", float(recorded), float(computed))
        return None


def _places(inbox: Inbox) -> dict[str, Callable[[Stamped], None]]:
    """How each kind of message gets into an inbox."""
    senders = inbox.senders
    states = {f"state{i}": partial(inbox.on_state, i) for i in senders.states}
    estimates = {f"estimate{i}": partial(inbox.on_estimate, i) for i in senders.estimators}
    own = {name: partial(setattr, inbox, name) for name in ("own", "near")}
    return {**own, **states, **estimates}


def _any_state(config: AgentConfig) -> AgentState:
    """A state that lends its shapes."""
    own = np.zeros(ODOMETRY_SIZE)
    own[6] = 1.0
    return Agent(config, own).state
