"""Plausibility checks for an unsigned link: a checksum of 16 bits accepts one broken packet in 65536.

A value that contradicts the previous one is accepted only when the next message confirms it. A vehicle repeats
its state; a broken packet is not repeated. A real change is delayed by one message: 20 ms for a position, one
request and its answer for a mode.
"""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np

from ptnsbc_core.types import Array


class ConfirmedValue:
    """A value that changes only when two messages agree."""

    def __init__(self) -> None:
        self._known: Hashable | None = None
        self._candidate: Hashable | None = None

    @property
    def unconfirmed(self) -> bool:
        """True if the newest message had a new value that no other message has confirmed yet."""
        return self._candidate is not None

    def accepts(self, value: Hashable) -> bool:
        """True if this message is plausible."""
        known = value in (self._known, self._candidate)
        if known:
            self._known = value
        self._candidate = None if known else value
        return known


class RateLimitedValue:
    """Numbers (n,) that move no faster than a vehicle can."""

    def __init__(self, step: Array, rate: Array) -> None:
        """`step` (n,): largest jump that is plausible at once; `rate` (n,): largest change per second."""
        self._step = step
        self._rate = rate
        self._seen: list[tuple[Array, float]] = []  # the last accepted, and the one not confirmed
        self.rejected = 0

    def accepts(self, numbers: Array, now_s: float) -> bool:
        """True if these numbers are plausible; False for NaN."""
        if any(self._follows(numbers, now_s, *seen) for seen in self._seen):
            self._seen = [(numbers, now_s)]
            return True
        self.rejected += bool(self._seen)
        self._seen = [*self._seen[:1], (numbers, now_s)] if self._seen else [(numbers, now_s)]
        return False

    def _follows(self, numbers: Array, now_s: float, last: Array, last_s: float) -> bool:
        return bool((np.abs(numbers - last) <= self._step + self._rate * (now_s - last_s)).all())
