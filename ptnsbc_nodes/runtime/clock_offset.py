"""Real time: how far the clock of this process is from the clocks of those it hears. No ROS in here.

All that a fleet does by time counts from one epoch, by the clock of each computer: who is ahead begins earlier,
takes every message for an old one and, beyond `communication.stale_s`, for a stale one. So the clocks must agree.

A message cannot have been under way for less than no time: the least age at which messages of one sender
arrive is their delay plus how far our clock is ahead. The delay of a network that can be flown over is small.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ptnsbc_io.wire import Stamped

LIMIT_S = 0.1
_WINDOW_S = 0.5


class Offset(NamedTuple):
    """A clock that is not ours."""

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

    def hear(self, now_ns: int, message: Stamped) -> None:
        if message.stamp_ns == self._stamp_ns:
            return
        self._stamp_ns = message.stamp_ns
        if (now_ns - self._since_ns) * 1e-9 > _WINDOW_S:
            self._before, self._now, self._since_ns = self._now, None, now_ns
        age_s = (now_ns - message.stamp_ns) * 1e-9
        self._now = age_s if self._now is None else min(self._now, age_s)

    @property
    def age_s(self) -> float | None:
        """None until a whole window has been heard: a first message may have been late."""
        if self._before is None or self._now is None:
            return self._before
        return min(self._before, self._now)


class ClockOffsetMonitor:
    """Compares our clock with the stamps of messages.

    Args:
        names: of the topics, in the order of what is looked at.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._least = [_Least() for _ in names]

    def look(self, now_ns: int, newest: Sequence[Stamped | None]) -> None:
        """Take in the newest message of each topic, None where there is none."""
        for least, message in zip(self._least, newest, strict=True):
            if message is not None:
                least.hear(now_ns, message)

    @property
    def offset(self) -> Offset | None:
        """The clock farthest from ours, if it is `LIMIT_S` away or more."""
        ages = ((name, least.age_s) for name, least in zip(self._names, self._least, strict=True))
        known = [Offset(name, age_s) for name, age_s in ages if age_s is not None]
        worst = max(known, key=lambda one: abs(one.ahead_s), default=None)
        return worst if worst is not None and abs(worst.ahead_s) >= LIMIT_S else None
