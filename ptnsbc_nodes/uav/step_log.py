"""The step log of a UAV in real time, from which its steps can be re-run. No ROS in here.

A recorder cannot know which messages a UAV held when it ticked, so the UAV publishes it. `/uavN/tick` gives
for each step its instant, its leg, and stamp and checksum of every message that the step used.
`/uavN/snapshot` holds, at times, the whole memory of the controller *after* the step it names. A re-run can
begin there, behind a message that the recording lacks.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.types import AgentState
from ptnsbc_io.cdr import Floats
from ptnsbc_io.wire import RowTemplate, Stamped, WireError
from ptnsbc_nodes.comm.graph import Senders
from ptnsbc_nodes.uav.uav_controller import StepTime, UavController
from ptnsbc_sim.counters import UavCounters
from ptnsbc_sim.scenario.constants import PlannerLimits

_STEP_FIELDS = ("sequence", *StepTime._fields)
_NO_MESSAGE = (-1, 0)
OWN, SLOTS = "own", "slots"


class UsedMessage(NamedTuple):
    """One message that a step used."""

    stamp_ns: int
    checksum: int  # of its decoded numbers


class TickNote(NamedTuple):
    """A decoded `/uavN/tick`."""

    sequence: int  # steps of this agent before this one; 0 after a restart of the controller
    moment: StepTime
    used: dict[str, UsedMessage]  # by the names of `sources`; without those that had no message


def sources(senders: Senders) -> tuple[str, ...]:
    """Names of the messages that a step can use."""
    states = (f"state{i}" for i in senders.states)
    decided = (SLOTS,) if senders.others else ()
    return (OWN, "near", *states, *(f"estimate{i}" for i in senders.estimators), *decided)


def used_by(controller: UavController) -> list[Stamped | None]:
    """The messages that the newest step has used, in the order of `sources`."""
    used = controller.inbox.used
    return [*used, controller.slots] if controller.inbox.senders.others else used


def checksum(message: Stamped) -> int:
    """Checksum of the decoded numbers: a step uses nothing else of a message."""
    return zlib.crc32(message.values.tobytes())


class TickTemplate:
    """Encoder of `/uavN/tick`."""

    def __init__(self, senders: Senders) -> None:
        names = [name for source in sources(senders) for name in (source, f"{source}_checksum")]
        self._template = RowTemplate(
            " ".join((*_STEP_FIELDS, *names)), len(_STEP_FIELDS) + len(names)
        )

    def encode(self, sequence: int, moment: StepTime, held: Iterable[Stamped | None]) -> bytes:
        """The tick of one step that used the messages `held`, in the order of `sources`."""
        numbers: list[int] = [sequence, *moment]
        for message in held:
            numbers += _NO_MESSAGE if message is None else (message.stamp_ns, checksum(message))
        return self._template.integers(numbers)


def tick_note(label: str, numbers: list[int]) -> TickNote:
    """The tick in a message; WireError when there is none."""
    names = label.split()
    paired = len(names) == len(numbers) and (len(names) - len(_STEP_FIELDS)) % 2 == 0
    if tuple(names[: len(_STEP_FIELDS)]) != _STEP_FIELDS or not paired:
        raise WireError(
            f"tick with {label!r}: expected {' '.join(_STEP_FIELDS)} and pairs after it"
        )
    first = len(_STEP_FIELDS)
    sequence, *fields, flying = numbers[:first]
    moment = StepTime._make((*fields, bool(flying)))
    pairs = zip(names[first::2], numbers[first::2], numbers[first + 1 :: 2], strict=True)
    used = {name: UsedMessage(stamp, crc) for name, stamp, crc in pairs if stamp >= 0}
    if OWN not in used:
        raise WireError("tick without an own odometry: expected one, every step uses it")
    return TickNote(sequence, moment, used)


class SnapshotTemplate:
    """Encoder of `/uavN/snapshot`."""

    def __init__(self, controller: UavController) -> None:
        kept = len(controller.memory)
        self.label = _label(controller.state, kept)
        self._template = RowTemplate(self.label, _length(controller.state) + kept)

    def encode(self, sequence: int, controller: UavController) -> bytes:
        """State, counters, limits and memory of the law after step number `sequence`."""
        rest = (controller.counters.numbers(), controller.limits, controller.memory)
        return self._template.floats(
            np.concatenate(([sequence], *_leaves(controller.state), *rest))
        )


def _length(state: AgentState) -> int:
    return 1 + sum(_sizes(state)) + UavCounters.SIZE + len(PlannerLimits._fields)


def _leaves(value: Any) -> Iterator[Floats]:
    """The numbers of a tree of tuples, in order."""
    if isinstance(value, tuple):
        for part in value:
            yield from _leaves(part)
    else:
        yield np.ravel(np.asarray(value, dtype=np.float64))


def _like(value: Any, numbers: Iterator[float]) -> Any:
    """The next numbers in the shape and types of `value`."""
    if isinstance(value, tuple):
        parts = [_like(part, numbers) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if isinstance(value, np.ndarray):
        return np.fromiter(numbers, np.float64, value.size).reshape(value.shape)
    return type(value)(next(numbers))


def _sizes(state: AgentState) -> list[int]:
    return [sum(leaf.size for leaf in _leaves(field)) for field in state]


def _label(state: AgentState, kept: int) -> str:
    counts = zip(state._fields, _sizes(state), strict=True)
    words = " ".join(f"{name}:{size}" for name, size in counts)
    limits = len(PlannerLimits._fields)
    law = f" law:{kept}" if kept else ""
    return f"sequence:1 {words} counters:{UavCounters.SIZE} limits:{limits}{law}"


class ControllerSnapshot(NamedTuple):
    """A decoded `/uavN/snapshot`."""

    sequence: int  # the step after which it was taken
    state: AgentState
    counters: Floats  # (UavCounters.SIZE,)
    limits: PlannerLimits
    memory: Floats  # (M,) of a law of the user


def current_label(label: str) -> str:
    """The label of a recorded snapshot in today's words: the counters once had another name."""
    return label.replace(" tally:", " counters:", 1)


def decode_snapshot(
    label: str, numbers: Floats, like: AgentState, kept: int = 0
) -> ControllerSnapshot:
    """The snapshot in a message; WireError unless it has a state like this, and `kept` numbers of a law."""
    expected, size = _label(like, kept), _length(like)
    if current_label(label) != expected or len(numbers) != size + kept:
        raise WireError(f"snapshot with {label!r}: expected {expected!r}")
    at = 1 + sum(_sizes(like))
    counters = numbers[at : at + UavCounters.SIZE]
    limits = PlannerLimits(*map(float, numbers[at + UavCounters.SIZE : size]))
    state: AgentState = _like(like, iter(numbers[1:at].tolist()))
    return ControllerSnapshot(int(numbers[0]), state, counters, limits, numbers[size:])
