"""The newest states of the vehicles, and their states at one common instant."""

from __future__ import annotations

from collections import deque

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.wire import Stamped

_KEPT_NS = 1_000_000_000
_SILENT_NS = 500_000_000


class RecentStates:
    """Odometry of each vehicle during the last second that it told.

    Messages of one instant arrive one after the other. Distances between the newest positions would therefore be
    wrong by the way of a vehicle between two messages, millimetres to centimetres.
    """

    def __init__(self) -> None:
        self._of: dict[int, deque[Stamped]] = {}

    def add(self, uav: int, message: Stamped) -> None:
        """Keep a state; one that was overtaken is dropped, and one from long before begins anew."""
        kept = self._of.setdefault(uav, deque())
        if kept and message.stamp_ns < kept[-1].stamp_ns - _KEPT_NS:
            kept.clear()
        if kept and message.stamp_ns <= kept[-1].stamp_ns:
            return
        kept.append(message)
        while kept[0].stamp_ns < message.stamp_ns - _KEPT_NS:
            kept.popleft()

    @property
    def common_ns(self) -> int:
        """The newest instant that every vehicle has reached, without those silent for 0.5 s; -1 before the first."""
        newest = [kept[-1].stamp_ns for kept in self._of.values()]
        last = max(newest, default=-1)
        return min((stamp for stamp in newest if stamp >= last - _SILENT_NS), default=-1)

    def at(self, stamp_ns: int) -> dict[int, Array]:
        """The odometry vectors (13,) of all vehicles at an instant, positions interpolated.

        A vehicle that has nothing before it or after it is where it told that it was.
        """
        return {uav: _at(kept, stamp_ns) for uav, kept in self._of.items()}


def _at(kept: deque[Stamped], stamp_ns: int) -> Array:
    after = next((one for one in kept if one.stamp_ns >= stamp_ns), kept[-1])
    before = next((one for one in reversed(kept) if one.stamp_ns <= stamp_ns), kept[0])
    if before.stamp_ns >= after.stamp_ns:
        return after.values
    share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    values: Array = np.array(after.values)
    values[:3] = before.values[:3] + share * (after.values[:3] - before.values[:3])
    return values
