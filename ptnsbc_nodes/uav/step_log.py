"""What a UAV notes in real time, so that its steps can be re-run from a bag. No ROS in here.

A recorder cannot know which message a UAV held when it ticked: it says so itself. `/uavN/tick` names
for each step its instant, its leg, and stamp and checksum of every message that went into it.
`/uavN/snapshot` holds, now and then, all that the controller remembers *after* the step it names: a
re-run can begin there, behind a message that the recording lacks.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.types import AgentState
from ptnsbc_io.wire import RowTemplate, Stamped, WireError
from ptnsbc_io.wire.cdr import Floats
from ptnsbc_nodes.comm.graph import Senders
from ptnsbc_nodes.uav.controller import StepTime, UavController, VehicleSpeedLimits
from ptnsbc_nodes.uav.counters import UavCounters

_WHEN = ("sequence", *StepTime._fields)
_NOTHING = (-1, 0)
OWN = "own"


class UsedMessage(NamedTuple):
    """One message that went into a step."""

    stamp_ns: int
    checksum: int  # of its decoded numbers


class TickNote(NamedTuple):
    """A decoded `/uavN/tick`."""

    sequence: int  # steps of this agent before this one; 0 again when the controller begins anew
    moment: StepTime
    used: dict[str, UsedMessage]  # by the names of `sources`; what was not there is left out


def sources(senders: Senders) -> tuple[str, ...]:
    """Names of what can go into a step, in the order of `Inbox.held`."""
    states = (f"state{i}" for i in senders.states)
    return (OWN, "near", *states, *(f"estimate{i}" for i in senders.estimators))


def checksum(message: Stamped) -> int:
    """Of the numbers alone: they are what a step is made of."""
    return zlib.crc32(message.values.tobytes())


class TickTemplate:
    """Encoder of the notes of one UAV."""

    def __init__(self, senders: Senders) -> None:
        names = [name for source in sources(senders) for name in (source, f"{source}_checksum")]
        self._template = RowTemplate(" ".join((*_WHEN, *names)), len(_WHEN) + len(names))

    def encode(self, sequence: int, moment: StepTime, held: Iterable[Stamped | None]) -> bytes:
        """The note of one step made of the messages `held`, in the order of `sources`."""
        numbers: list[int] = [sequence, *moment]
        for message in held:
            numbers += _NOTHING if message is None else (message.stamp_ns, checksum(message))
        return self._template.integers(numbers)


def tick_note(label: str, numbers: list[int]) -> TickNote:
    """The note from the content of its message; WireError when it is none."""
    names = label.split()
    paired = len(names) == len(numbers) and (len(names) - len(_WHEN)) % 2 == 0
    if tuple(names[: len(_WHEN)]) != _WHEN or not paired:
        raise WireError(f"tick with {label!r}: expected {' '.join(_WHEN)} and pairs after it")
    sequence, now_ns, elapsed_ns, mode, t0_ns, first_t0_ns, flying = numbers[: len(_WHEN)]
    when = StepTime(now_ns, elapsed_ns, mode, t0_ns, first_t0_ns, bool(flying))
    first = len(_WHEN)
    pairs = zip(names[first::2], numbers[first::2], numbers[first + 1 :: 2], strict=True)
    used = {name: UsedMessage(stamp, crc) for name, stamp, crc in pairs if stamp >= 0}
    if OWN not in used:
        raise WireError("tick without an own odometry: expected one, no step is made without")
    return TickNote(sequence, when, used)


class SnapshotTemplate:
    """Encoder of what one controller remembers."""

    def __init__(self, like: UavController) -> None:
        self.label = _label(like.state)
        self._template = RowTemplate(self.label, _length(like.state))

    def encode(self, sequence: int, pilot: UavController) -> bytes:
        """State, counters and limits after step number `sequence`."""
        rest = (pilot.tally.counters(), pilot.limits)
        return self._template.floats(np.concatenate(([sequence], *_leaves(pilot.state), *rest)))


def _length(state: AgentState) -> int:
    return 1 + sum(_sizes(state)) + UavCounters.SIZE + len(VehicleSpeedLimits._fields)


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


def _label(state: AgentState) -> str:
    counts = zip(state._fields, _sizes(state), strict=True)
    words = (f"{name}:{size}" for name, size in counts)
    return " ".join(
        (
            "sequence:1",
            *words,
            f"tally:{UavCounters.SIZE}",
            f"limits:{len(VehicleSpeedLimits._fields)}",
        )
    )


class ControllerSnapshot(NamedTuple):
    """A decoded `/uavN/snapshot`."""

    sequence: int  # the step after which it was taken
    state: AgentState
    counters: Floats  # (Tally.SIZE,)
    limits: VehicleSpeedLimits


def recall(label: str, numbers: Floats, like: AgentState) -> ControllerSnapshot:
    """What a snapshot holds; WireError when it is not of a state `like` this one."""
    if label != _label(like) or len(numbers) != _length(like):
        raise WireError(f"snapshot with {label!r}: expected {_label(like)!r}")
    at = 1 + sum(_sizes(like))
    counters = numbers[at : at + UavCounters.SIZE]
    limits = VehicleSpeedLimits(*(float(number) for number in numbers[at + UavCounters.SIZE :]))
    state: AgentState = _like(like, iter(numbers[1:at].tolist()))
    return ControllerSnapshot(int(numbers[0]), state, counters, limits)
