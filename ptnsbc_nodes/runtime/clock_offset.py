"""Real time: how far the clock of this process is from the clocks of its senders. This module imports no ROS.

All times of a flight count from one epoch, by the clock of each computer. So the clocks must agree: a computer
that is ahead begins earlier, and takes every message for an old one, beyond `communication.stale_s` for a stale one.

The least age at which messages of one sender arrive is the delay of the network plus how far our clock is ahead.
The delay of a network that can carry a flight is small.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ptnsbc_io.wire import Stamped

LIMIT_S = 0.1
_WINDOW_S = 0.5


class Offset(NamedTuple):
    """The clock of a sender, compared with ours."""

    name: str  # of the topic whose stamps differ
    ahead_s: float  # our clock minus the sender's, plus the least delay of its messages

    def __str__(self) -> str:
        way = "ahead of" if self.ahead_s > 0 else "behind"
        return f"clock {abs(self.ahead_s):.2f} s {way} {self.name}"


class _Least:
    """The least age [s] of one sender's messages in the last one to two windows."""

    __slots__ = ("_before", "_now", "_since_ns", "_stamp_ns")

    def __init__(self) -> None:
        self._stamp_ns = -1
        self._since_ns = 0
        self._before: float | None = None
        self._now: float | None = None

    def add(self, now_ns: int, message: Stamped) -> None:
        if message.stamp_ns == self._stamp_ns:
            return
        self._stamp_ns = message.stamp_ns
        if (now_ns - self._since_ns) * 1e-9 > _WINDOW_S:
            self._before, self._now, self._since_ns = self._now, None, now_ns
        age_s = (now_ns - message.stamp_ns) * 1e-9
        self._now = age_s if self._now is None else min(self._now, age_s)

    @property
    def age_s(self) -> float | None:
        """None before the end of the first window: its first message may have been late."""
        if self._before is None or self._now is None:
            return self._before
        return min(self._before, self._now)


class ClockOffsetMonitor:
    """Compares our clock with the stamps of messages.

    Args:
        names: Of the topics, in the order of the messages in `look`.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._least = [_Least() for _ in names]

    def look(self, now_ns: int, newest: Sequence[Stamped | None]) -> None:
        """Take in the newest message of each topic, None where there is none."""
        for least, message in zip(self._least, newest, strict=True):
            if message is not None:
                least.add(now_ns, message)

    @property
    def offset(self) -> Offset | None:
        """The clock farthest from ours, if it is at least `LIMIT_S` away."""
        ages = ((name, least.age_s) for name, least in zip(self._names, self._least, strict=True))
        known = [Offset(name, age_s) for name, age_s in ages if age_s is not None]
        worst = max(known, key=lambda one: abs(one.ahead_s), default=None)
        return worst if worst is not None and abs(worst.ahead_s) >= LIMIT_S else None
