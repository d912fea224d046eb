"""The first publisher of a topic is kept; the messages of a second one are refused.

Publishers are told apart by their GIDs, and where a message comes without one, by how they number their messages. A
process that was killed and started again has a new GID, and the graph shows the old one until the lease of the dead
participant is over. So a publisher of a node with the same name may take the place of the first one, once that cannot
be heard any more. An outsider may not, even when the first one has ended: it would speak for every UAV that dies.

The GID of a message costs half of its reception. While the graph shows one publisher only, its numbers are enough: a
second one begins with 1, and is noticed by its first message whose number does not follow.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from enum import Enum

SILENT_S = 1.0
"""A publisher of states that has not been heard for so long gives way to one of the same node."""
_LOST = 100  # at most so many messages in a row are lost
_LOOK_EVERY = 100  # so many messages of the first one before the graph is asked whether it is alone
_UNNAMED = "an unknown node"
_LOOK_S = 0.1  # at most so often a flood of messages makes us ask for the graph


class Yields(Enum):
    """The moment at which the first publisher gives way to a second one of a node with the same name."""

    SILENT = "silent"  # states in real time: when it has been silent
    AT_ONCE = "at once"  # events: silence is usual there
    UNNAMED = "unnamed"  # lock-step: at once, also when the name is not known yet: a lost message would stop the flight


class FirstSender:
    """Decides which publisher of one topic is heard.

    Args:
        yields: when the first one gives way.
        graph: asks for the publishers of the topic: GID to name of the node, empty while that is unknown.
        any_node: once the graph shows the first one no more, one of another node may take its place.
        by_numbers: while it is alone its numbers are enough. Of rare messages each counts: they are judged by GIDs.
        now_s: steady time.
    """

    def __init__(
        self,
        yields: Yields,
        graph: Callable[[], Mapping[bytes, str]],
        any_node: bool = False,
        by_numbers: bool = False,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.kept: bytes | None = None
        self.lost = 0
        """Messages that the kept publisher sent between two that were heard, and that have not come."""
        self._yields = yields
        self._graph = graph
        self._any_node = any_node
        self._by_numbers = by_numbers
        self._now_s = now_s
        self._name = ""  # of the node of the kept one
        self._names: Mapping[bytes, str] = {}
        self._numbers: dict[bytes, int] = {}  # newest of each publisher
        self._in_graph = False  # the graph has shown the kept one
        self._heard_s = self._looked_s = float("-inf")
        self._newest = self._in_a_row = (
            0  # of the kept one: its newest number; messages since another one was heard
        )

    def others(self) -> list[str]:
        """Nodes of second publishers by the graph as it is now."""
        self._look(self._now_s())
        names = {name or _UNNAMED for gid, name in self._names.items() if gid != self.kept}
        return sorted(names)

    def follows(self, number: int) -> bool:
        """True if a message can be the next of the kept publisher: enough where no second one is known."""
        if not self._newest < number <= self._newest + _LOST:
            self._in_a_row = 0
            return False
        self.lost += number - self._newest - 1
        self._newest, self._heard_s = number, self._now_s()
        return True

    def is_alone(self) -> bool:
        """True if its numbers are enough: it has been heard for a while, and is the only one in the graph."""
        self._in_a_row += self._by_numbers
        if self._in_a_row < _LOOK_EVERY or self.kept is None:
            return False
        self._in_a_row = 0
        self._look(self._now_s())
        self._newest = self._numbers.get(self.kept, 0)
        return self._newest > 0 and set(self._names) == {self.kept}

    def objection(self, gid: bytes, number: int) -> str:
        """The reason why a message is refused; empty when it is taken.

        Args:
            gid: of its publisher; empty when it is not known.
            number: by which the publisher counts its messages.
        """
        now_s = self._now_s()
        gid = gid or self._nearest(number, now_s)
        if self.kept is None and not gid:
            return ""
        if gid != self.kept:
            if (gid and gid not in self._names) or now_s - self._looked_s >= _LOOK_S:
                self._look(now_s)
            if self.kept is None or self._gives_way(gid, now_s):
                self._keep(gid)
        before, self._numbers[gid] = self._numbers.get(gid, number), number
        if gid != self.kept:
            self._in_a_row = 0
            return f"is from a second publisher: {self._names.get(gid) or _UNNAMED}"
        self._heard_s = now_s
        self.lost += max(number - max(before, self._newest) - 1, 0)
        return ""

    def _nearest(self, number: int, now_s: float) -> bytes:
        """The publisher whose newest number is the nearest below one; the first when it is the only one."""
        if self.kept is not None and self.kept in self._numbers:
            self._numbers[self.kept] = max(self._newest, self._numbers[self.kept])
        ahead = {gid: number - newest for gid, newest in self._numbers.items()}
        near = {gid: step for gid, step in ahead.items() if 0 < step <= _LOST}
        if near:
            return min(near, key=lambda gid: near[gid])
        self._look(now_s)
        if self.kept is not None and (len(self._names) < 2 or self._yields is Yields.UNNAMED):
            return self.kept
        return b""

    def _look(self, now_s: float) -> None:
        self._names, self._looked_s = self._graph(), now_s
        ended = self._numbers.keys() - self._names.keys() - {self.kept}
        for gid in ended:
            del self._numbers[gid]
        if self.kept is not None and self.kept in self._names:
            self._in_graph, self._name = True, self._names[self.kept] or self._name
        elif self.kept is None or self._in_graph or self._silent(now_s):
            self._replace()

    def _replace(self) -> None:
        """The first one has ended. One of its node comes before an outsider that was there already."""
        anybody = self.kept is None or self._any_node or not self._name
        found = sorted(self._names, key=lambda gid: self._names[gid] != self._name)
        if found and (anybody or self._names[found[0]] == self._name):
            self._keep(found[0])
            self._heard_s = float("-inf")

    def _keep(self, gid: bytes) -> None:
        self.kept, self._in_graph, self._newest = gid, gid in self._names, 0
        self._name = self._names.get(gid, "")

    def _gives_way(self, gid: bytes, now_s: float) -> bool:
        theirs = self._names.get(gid, "")
        match self._yields:
            case Yields.SILENT:
                return theirs == self._name and self._silent(now_s)
            case Yields.AT_ONCE:
                return bool(theirs) and theirs == self._name
            case Yields.UNNAMED:
                return not theirs or theirs == self._name

    def _silent(self, now_s: float) -> bool:
        return now_s - self._heard_s > SILENT_S
