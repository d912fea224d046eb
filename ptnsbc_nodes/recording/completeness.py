"""Lock-step: up to which stamp a recorder has received every topic. No ROS in here.

Every regular topic has a message each so many ticks, and DDS keeps the order of one publisher. So a topic whose newest
stamp is k and whose period is p lacks no message before k + p. Messages that are lost on the way and sent again hold
this back; the sim pauses before a queue can overflow, and the recorder does not sort beyond it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

_NEVER = 2**63 - 1
_NO_SILENCES: Mapping[str, Sequence[tuple[int, int]]] = MappingProxyType({})


class Completeness:
    """The stamp up to which all of some sources have been received.

    Args:
        sources: names; a source is what one publisher sends on one topic.
        silences: first instant [ns], and the first after it, of what a source sends nothing in.
    """

    def __init__(
        self,
        sources: Iterable[str],
        silences: Mapping[str, Sequence[tuple[int, int]]] = _NO_SILENCES,
    ) -> None:
        self._silences = silences
        self._newest = dict.fromkeys(sources, -1)
        self._gap: dict[str, int] = {}  # shortest time between two messages of a source
        self._bounds = dict(self._newest)  # up to which each source is complete
        self.complete_ns = -1
        self.tick_ns = _NEVER
        """Shortest time between two messages of any source: the control period, once two messages have come."""
        self._last = len(self._bounds)  # sources that hold `complete_ns` back

    def add(self, source: str, stamp_ns: int) -> bool:
        """A message of a source, whatever its name; returns whether `complete_ns` has moved."""
        newest = self._newest.get(source)
        if newest is None or stamp_ns <= newest:
            return False
        if newest >= 0:
            gap = min(stamp_ns - newest, self._gap.get(source, _NEVER))
            self._gap[source] = gap
            self.tick_ns = min(self.tick_ns, gap)
        else:
            gap = 1
        self._newest[source] = stamp_ns
        bound = stamp_ns + gap - 1
        for first_ns, end_ns in self._silences.get(source, ()):
            if first_ns <= bound + 1 < end_ns:
                bound = end_ns - 1
        before, self._bounds[source] = self._bounds[source], bound
        if before > self.complete_ns:
            return False
        self._last -= 1
        return self._move()

    def lose(self, source: str) -> bool:
        """Wait for a source no longer; returns whether `complete_ns` has moved."""
        if source not in self._newest:
            return False
        del self._newest[source]
        if self._bounds.pop(source) <= self.complete_ns:
            self._last -= 1
        return self._move()

    def _move(self) -> bool:
        if self._last > 0:
            return False
        bounds = self._bounds.values()
        self.complete_ns = min(bounds, default=_NEVER)
        self._last = sum(bound == self.complete_ns for bound in bounds)
        return True
