"""Recorded messages of a bag that is read as a stream: kept by stamp, and compared with what is computed."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ptnsbc_io.wire import (
    Stamped,
    WireError,
    decode_near,
    decode_odometry,
    decode_velocity,
    decode_wrench,
    peek_stamp,
)

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
            self._clear()

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

    def _clear(self) -> None:
        # The newest message is always kept: the last state of a sender that has ended still counts.
        keep = bisect_left(self._stamps, self._stamps[-1] - _KEPT_NS)
        for stamp_ns in self._stamps[:keep]:
            del self._messages[stamp_ns]
            self._decoded.pop(stamp_ns, None)
        del self._stamps[:keep]


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
    return Mismatch(f"{topic} byte {at}", _byte(recorded, at), _byte(computed, at))


def _byte(data: bytes, at: int) -> str:
    return f"{data[at]:#04x}" if at < len(data) else f"nothing ({len(data)} bytes)"
