"""The order of messages in a lock-step bag: by stamp and topic, independent of their arrival.

DDS keeps the order of the messages of one publisher, but not between publishers: the same flight
arrives in another order each time. The buffer holds a message until 20 later stamps have arrived, and until the
caller knows that no older message is under way.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from typing import NamedTuple

HOLD_TICKS = 20
_NO_LIMIT = 2**63 - 1


class PendingMessage(NamedTuple):
    """A message in the buffer."""

    stamp_ns: int
    topic: str
    arrival: int  # in its topic; 0 in a shared topic, where the bytes decide instead
    data: bytes


class ReorderBuffer:
    """Sorts messages by (stamp, topic, arrival in that topic) over a window of `hold_ticks` stamps.

    The window counts stamps that occur. So the length of a tick need not be known, and a stamp far
    ahead (an epoch announced in advance) releases no other message. Within `shared` topics, which have several
    publishers, the order of arrival is random too.
    """

    def __init__(self, shared: frozenset[str] = frozenset(), hold_ticks: int = HOLD_TICKS) -> None:
        self._shared = shared
        self._hold_ticks = hold_ticks
        self._held: dict[int, list[PendingMessage]] = {}
        self._stamps: list[int] = []  # heap of the keys of _held
        self._arrivals: dict[str, int] = {}
        self.complete_ns = _NO_LIMIT  # up to this stamp everything has arrived
        self._released_ns = -1
        self.late = 0  # messages that came after their stamp was released: in chance order

    def push(self, stamp_ns: int, topic: str, data: bytes) -> None:
        """Add a message."""
        arrival = self._arrivals.get(topic, 0)
        if topic not in self._shared:
            self._arrivals[topic] = arrival + 1
        self.late += stamp_ns <= self._released_ns
        if stamp_ns not in self._held:
            self._held[stamp_ns] = []
            heapq.heappush(self._stamps, stamp_ns)
        self._held[stamp_ns].append(PendingMessage(stamp_ns, topic, arrival, data))

    def release(self) -> Iterable[PendingMessage]:
        """The messages that nothing can come before, in order; they are held no longer."""
        return self._release(self._hold_ticks)

    def first(self) -> Iterable[PendingMessage]:
        """The messages of the oldest stamp, in order, if it is complete: they wait for no later stamps.

        For a caller who knows that no topic without regular messages has one more of this stamp.
        """
        return self._release(max(len(self._stamps) - 1, 0))

    def flush(self) -> Iterable[PendingMessage]:
        """All messages that are still held, in order."""
        self.complete_ns = _NO_LIMIT
        return self._release(0)

    def _release(self, keep: int) -> Iterable[PendingMessage]:
        released: list[PendingMessage] = []
        while len(self._stamps) > keep and self._stamps[0] <= self.complete_ns:
            stamp_ns = heapq.heappop(self._stamps)
            self._released_ns = max(stamp_ns, self._released_ns)
            released += sorted(self._held.pop(stamp_ns))
        return released
