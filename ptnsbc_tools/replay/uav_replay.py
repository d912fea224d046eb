"""One UAV of a re-run: its controller steps on recorded inputs, and its outputs are compared with the recorded."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from ptnsbc_core.agent import Agent, PackedOutputs
from ptnsbc_core.types import ODOMETRY_SIZE
from ptnsbc_io.wire import (
    Stamped,
    WireError,
    decode_floats,
    decode_near,
    decode_odometry,
    decode_velocity,
    decode_wrench,
    peek_stamp,
)
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import AgentMessages
from ptnsbc_nodes.comm.announcements import DecidedSlots
from ptnsbc_nodes.comm.graph import CommunicationGraph, Senders
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_nodes.uav.step_log import (
    SLOTS,
    ControllerSnapshot,
    SnapshotTemplate,
    TickNote,
    checksum,
    current_label,
    decode_snapshot,
)
from ptnsbc_nodes.uav.uav_controller import StepTime, UavController, UavFaults
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.constants import PlannerLimits

_KEPT_NS = 5_000_000_000  # age behind the newest message at which a message is dropped
_SPARE = 256  # stamps between two clearings
_NONE: list[bytes] = []

_DECODERS: dict[str, Callable[[bytes], Stamped]] = {
    "nav_msgs/msg/Odometry": decode_odometry,
    "sensor_msgs/msg/PointCloud2": decode_near,
}


class TopicBuffer:
    """The newest messages of one topic by stamp; several may have the same stamp."""

    def __init__(self, type_name: str) -> None:
        self._decode = _DECODERS.get(type_name)
        self._stamps: list[int] = []  # ascending
        self._messages: dict[int, list[bytes]] = {}
        self._decoded: dict[int, list[Stamped]] = {}  # as far as a step needed them

    def put(self, data: bytes) -> None:
        """Keep a message by the stamp in its header."""
        stamp_ns = peek_stamp(data)
        messages = self._messages.get(stamp_ns)
        if messages is not None:
            messages.append(data)
            return
        self._messages[stamp_ns] = [data]
        stamps = self._stamps
        if not stamps or stamp_ns > stamps[-1]:
            stamps.append(stamp_ns)
        else:
            insort(stamps, stamp_ns)
        if len(stamps) % _SPARE == 0:
            # The newest message is always kept: the last state of a sender that has ended still counts.
            keep = bisect_left(stamps, stamps[-1] - _KEPT_NS)
            for old_ns in stamps[:keep]:
                del self._messages[old_ns]
                self._decoded.pop(old_ns, None)
            del stamps[:keep]

    @property
    def newest_ns(self) -> int:
        """The newest stamp, -1 before the first message."""
        return self._stamps[-1] if self._stamps else -1

    def at(self, stamp_ns: int) -> list[bytes]:
        """Messages with this stamp, in the order of the recording."""
        return self._messages.get(stamp_ns, _NONE)

    def read(self, stamp_ns: int) -> list[Stamped]:
        """Messages with this stamp, decoded; WireError when one cannot be decoded."""
        data = self._messages.get(stamp_ns, _NONE)
        found = self._decoded.get(stamp_ns)
        if found is None or len(found) < len(data):
            if self._decode is None:
                raise WireError("a message that no step is made of")
            found = [self._decode(one) for one in data]
            self._decoded[stamp_ns] = found
        return found

    def before(self, stamp_ns: int) -> Stamped | None:
        """The newest message stamped before `stamp_ns`, decoded."""
        index = bisect_left(self._stamps, stamp_ns)
        return self.read(self._stamps[index - 1])[-1] if index else None


_ODOMETRY = (
    *(f"pose.position.{axis}" for axis in "xyz"),
    *(f"pose.orientation.{axis}" for axis in "xyzw"),
    *(f"twist.linear.{axis}" for axis in "xyz"),
    *(f"twist.angular.{axis}" for axis in "xyz"),
)
_TWIST = tuple(f"twist.{part}.{axis}" for part in ("linear", "angular") for axis in "xyz")
_WRENCH = tuple(f"wrench.{part}.{axis}" for part in ("force", "torque") for axis in "xyz")

_FIELDS: dict[str, tuple[Callable[[bytes], Stamped], tuple[str, ...]]] = {
    "formation_state": (decode_odometry, _ODOMETRY),
    "leader_estimate": (decode_odometry, _ODOMETRY),
    "setpoint/velocity": (decode_velocity, _TWIST),
    "setpoint/wrench": (decode_wrench, _WRENCH),
}


class Mismatch(NamedTuple):
    """A recorded and a computed value that differ."""

    field: str  # topic and field, or what else differs
    recorded: str
    computed: str
    difference: float | None = None  # computed - recorded, where both are numbers


@dataclass(frozen=True)
class Difference:
    """The first value of one UAV that differs from the recording."""

    uav: int
    tick: int  # steps of this UAV before it, as the process or the bag counts them
    t_s: float  # after the epoch; negative before it
    stamp_ns: int
    field: str  # see Mismatch
    recorded: str
    computed: str
    difference: float | None

    def __str__(self) -> str:
        by = "" if self.difference is None else f", difference {self.difference:.3g}"
        return (
            f"tick {self.tick} (t = {self.t_s:.3f} s), uav{self.uav}, {self.field}: "
            f"recorded {self.recorded}, computed {self.computed}{by}"
        )


def of_numbers(field: str, recorded: float, computed: float) -> Mismatch:
    """Two numbers that differ, with all their digits."""
    return Mismatch(field, repr(recorded), repr(computed), computed - recorded)


def of_texts(field: str, recorded: str | None, computed: str) -> Mismatch:
    """Two values of /diagnostics, with their difference where they are numbers."""
    if recorded is None:
        return Mismatch(field, "nothing", computed)
    try:
        return Mismatch(field, recorded, computed, float(computed) - float(recorded))
    except ValueError:
        return Mismatch(field, recorded, computed)


def of_messages(topic: str, recorded: bytes, computed: bytes) -> Mismatch:
    """The first field of a message on `topic` that differs, or the first byte."""
    decode, names = _FIELDS[topic]
    try:
        found, made = decode(recorded), decode(computed)
    except WireError as error:
        return Mismatch(topic, f"a message that cannot be read ({error})", "a message")
    if found.stamp_ns != made.stamp_ns:
        return Mismatch(f"{topic} header.stamp", str(found.stamp_ns), str(made.stamp_ns))
    unequal = np.flatnonzero(found.values.view(np.int64) != made.values.view(np.int64))
    if unequal.size:
        k = int(unequal[0])
        return of_numbers(f"{topic} {names[k]}", float(found.values[k]), float(made.values[k]))
    size = min(len(recorded), len(computed))
    pairs = zip(recorded[:size], computed[:size], strict=True)
    at = next((k for k, (a, b) in enumerate(pairs) if a != b), size)
    found_byte, made_byte = (
        f"{data[at]:#04x}" if at < len(data) else f"nothing ({len(data)} bytes)"
        for data in (recorded, computed)
    )
    return Mismatch(f"{topic} byte {at}", found_byte, made_byte)


_SENSORS = ("own", "near")
_KEPT_STATUSES = 64  # twelve seconds; nobody takes the statuses of steps that are not made
OUTPUTS = tuple(_FIELDS)


class Gap(NamedTuple):
    """Steps that could not be re-run."""

    first_s: float  # after the epoch
    last_s: float
    steps: int
    reason: str


class MissingError(Exception):
    """An input of a step is not in the recording."""


@dataclass
class Account:
    """The result of a re-run for one UAV."""

    steps: int = 0  # re-run
    compared: int = 0  # outputs, counters and snapshots
    waiting: int = 0  # steps before the first leg that were not re-run; they do not count
    silent: int = 0  # last steps without a recorded output
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
    """The topic of each input of a UAV; the slots are no input of the inbox."""
    known = {"own": topics.odom(uav), "near": topics.near(uav)}
    known |= {f"state{i}": topics.formation_state(i) for i in senders.states}
    heard = senders.heard_estimators if senders.every_tick else senders.estimators
    known |= {f"estimate{i}": topics.leader_estimate(i) for i in heard}
    return known


def heard_topics(senders: Senders) -> list[topics.Topic]:
    """The topics of the neighbours that a UAV may hear, whatever its slot is."""
    states = [topics.formation_state(i) for i in senders.heard_states]
    return states + [topics.leader_estimate(i) for i in senders.heard_estimators]


class UavReplay:
    """The controller of a UAV and the recorded outputs."""

    def __init__(
        self,
        scenario: Scenario,
        uav: int,
        edges: CommunicationGraph,
        decided: DecidedSlots,
        fleet: str = "",
    ) -> None:
        self.uav = uav
        self.senders = edges.senders(uav)
        self._scenario, self._fleet = scenario, fleet
        self._decided = decided
        self.account = Account()
        self.outputs = [f"/uav{uav}/{name}" for name in OUTPUTS]
        self.recorded_counters: dict[int, list[dict[str, str]]] = {}  # of /diagnostics, by ticks
        self._edges = edges
        self._encoder = AgentMessages(uav, fleet)
        self._t0_ns: int | None = None  # first epoch of the step before
        self._snapshot: SnapshotTemplate | None = None
        self.next_step: int | None = None  # number of the next step; None: a step was left out
        self.reset()

    def begin(self, snapshot: bytes | None) -> None:
        """The controller starts, or starts again; its limits are in its first snapshot."""
        limits = None if snapshot is None else self._decode_snapshot(snapshot).limits
        self.reset(limits)
        self.next_step = 0

    def reset(self, limits: PlannerLimits | None = None) -> None:
        """Forget the state of the controller, because a step was left out; only a snapshot restores it."""
        self.next_step = None
        self._held: dict[str, Stamped] = {}
        self.inputs = source_topics(self.uav, self.senders)
        self.controller = UavController(self._scenario, self.uav, self._edges)
        if limits is not None:
            self.controller.config = limits.applied_to(self.controller.config)
        inbox = self.controller.inbox
        self._put: dict[str, Callable[[Stamped], None]] = {
            **{name: partial(setattr, inbox, name) for name in ("own", "near")},
            **{f"state{i}": queue.put for i, queue in inbox.state_queues.items()},
            **{f"estimate{i}": queue.put for i, queue in inbox.estimate_queues.items()},
        }

    def resume(self, note: TickNote, snapshot: bytes) -> None:
        """Continue after the step of a note, with its snapshot."""
        found = self._decode_snapshot(snapshot)
        self.reset(found.limits)
        if SLOTS in note.used:
            self.take_slot(note.used[SLOTS].stamp_ns)
        self.controller.resume(found.state, found.counters, found.memory)
        self.next_step = note.sequence + 1

    def follow(self, scenario: Scenario | None) -> None:
        """Fly by the mission as it goes on after a word."""
        if scenario is not None and scenario is not self._scenario:
            self._scenario = scenario
            self.controller.follow(scenario)

    def take_slot(self, t0_ns: int) -> None:
        """Fly by the slot that the epoch at `t0_ns` decided; MissingError when that is not recorded."""
        slots = self._decided.of(t0_ns)
        if slots is None:
            raise MissingError(f"{topics.SLOTS.name} stamped {t0_ns} is not recorded")
        self.controller.take_slot(t0_ns, slots)
        self.inputs = source_topics(self.uav, self.controller.inbox.senders)

    def _decode_snapshot(self, snapshot: bytes) -> ControllerSnapshot:
        row = decode_floats(snapshot)
        numbers = np.asarray(row.values, dtype=np.float64)
        level = np.zeros(ODOMETRY_SIZE)
        level[6] = 1.0
        # A state that has the shapes of all states.
        like = Agent(self.controller.config, level).state
        return decode_snapshot(row.label, numbers, like, len(self.controller.memory))

    def hold(self, name: str, message: Stamped) -> None:
        """Put a message into the inbox."""
        if self._held.get(name) is not message:
            self._held[name] = message
            self._put[name](message)

    def fetch(self, note: TickNote, buffers: Mapping[str, TopicBuffer]) -> Mismatch | None:
        """Put the inputs of a real-time step into the inbox; returns the first sensor message that differs.

        A UAV that ticks twice on one odometry sends two messages with one stamp. When none of the recorded
        ones is the one that was used, that one is missing. A message of another UAV that was changed is found
        when that UAV is compared.
        """
        wrong = self._fetch_slots(note)
        for name, used in note.used.items():
            if name == SLOTS:
                continue
            held = self._held.get(name)
            if held is not None and used == (held.stamp_ns, checksum(held)):
                continue
            if name not in self.inputs:
                raise WireError(f"{name} went into a step: not an input in this scenario")
            topic = self.inputs[name].name
            found = buffers[topic].read(used.stamp_ns)
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

    def _fetch_slots(self, note: TickNote) -> Mismatch | None:
        """Take the slot of a step; returns what differs from the decision in the bag."""
        used = note.used.get(SLOTS)
        if used is None:
            return None
        self.take_slot(used.stamp_ns)
        slots = self.controller.slots
        if slots is None or checksum(slots) == used.checksum:
            return None
        return Mismatch(
            f"{topics.SLOTS.name}, of the epoch stamped {used.stamp_ns}",
            f"checksum {checksum(slots):08x} in the bag",
            f"{used.checksum:08x} noted by the UAV",
        )

    def step(self, at: StepTime, cutoff_ns: int = NO_CUTOFF_NS) -> PackedOutputs:
        """Make one control step on the messages in the inbox."""
        self.account.steps += 1
        if at.first_t0_ns != self._t0_ns:
            self._t0_ns = at.first_t0_ns
            faults = UavFaults(self._scenario, self.uav)
            faults.begin(at.first_t0_ns)
            self._encoder = AgentMessages(self.uav, self._fleet, faults.sending)
        if self.next_step is not None:
            self.next_step += 1
        return self.controller.step(at, cutoff_ns)

    def compare(
        self,
        outputs: PackedOutputs,
        buffers: Mapping[str, TopicBuffer],
        expected: int | None = None,
    ) -> Mismatch | None:
        """The first output that differs from the recorded messages in `buffers`.

        Where several may have the stamp of this step, `expected` is their number; the last ones may be missing at the
        end of the recording.
        """
        own = self.controller.inbox.own
        if own is None:  # the step needed it
            raise WireError("no own odometry")
        recorded = [buffers[name].at(own.stamp_ns) for name in self.outputs]
        if not any(recorded):
            self.account.silent += 1
            return None
        # Silence at the end: the process has ended. Silence in between: a gap.
        self.account.unrecorded += len(OUTPUTS) * self.account.silent
        self.account.silent = 0
        made = self._encoder.all(own, outputs)
        for name, topic, found, computed in zip(OUTPUTS, self.outputs, recorded, made, strict=True):
            buffer = buffers[topic]
            if len(computed) % 4:  # as DDS delivers it
                computed += bytes(-len(computed) % 4)
            if computed in found:
                self.account.compared += 1
            elif not found or (
                expected is not None
                and (len(found) < expected or found is buffer.at(buffer.newest_ns))
            ):
                self.account.unrecorded += 1
            else:
                return of_messages(name, found[0], computed)
        return None

    def keep_counters(self, ticks: int, values: dict[str, str]) -> None:
        """Keep the values of a recorded status until that many steps are made."""
        kept = self.recorded_counters
        kept.setdefault(ticks, []).append(values)
        if len(kept) > _KEPT_STATUSES:
            del kept[next(iter(kept))]

    def compare_counters(self) -> Mismatch | None:
        """The first counter of /diagnostics that differs at this number of steps."""
        found = self.recorded_counters.pop(self.controller.counters.ticks, None)
        if found is None:
            return None
        own = self.controller.counters.values()
        for values in found:
            for key, computed in own.items():
                recorded = values.get(key)
                if recorded != computed:
                    return of_texts(f"diagnostics {key}", recorded, computed)
            self.account.compared += 1
        return None

    def compare_snapshot(self, sequence: int, data: bytes) -> Mismatch | None:
        """The first number of the controller state that differs."""
        self._snapshot = self._snapshot or SnapshotTemplate(self.controller)
        made = self._snapshot.encode(sequence, self.controller)
        if made == data[: len(made)]:
            self.account.compared += 1
            return None
        found, own = decode_floats(data), decode_floats(made)
        if current_label(found.label) != own.label:
            return Mismatch("snapshot", found.label, own.label)
        names = [
            f"{word.partition(':')[0]}[{k}]"
            for word in own.label.split()
            for k in range(int(word.partition(":")[2]))
        ]
        for name, recorded, computed in zip(names, found.values, own.values, strict=True):
            if recorded.tobytes() != computed.tobytes():
                return of_numbers(f"snapshot {name}", float(recorded), float(computed))
        self.account.compared += 1
        return None
