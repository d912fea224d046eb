"""What is believed on an unsigned link: a checksum of 16 bits lets one broken packet in 65536 through.

So what contradicts what was heard before counts only when the next message says the same. A vehicle repeats
itself, an accident does not. It costs a real change one message: 20 ms of a position, and as long as the answer
to a question takes of a mode.
"""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np

from ptnsbc_core.types import Array


class ConfirmedValue:
    """A value that may change, but not by one message alone."""

    def __init__(self) -> None:
        self._known: Hashable | None = None
        self._doubted: Hashable | None = None

    @property
    def doubts(self) -> bool:
        """Whether the newest message said something that none has confirmed yet."""
        return self._doubted is not None

    def admits(self, value: Hashable) -> bool:
        """Whether to believe this message."""
        known = value in (self._known, self._doubted)
        if known:
            self._known = value
        self._doubted = None if known else value
        return known


class RateLimitedValue:
    """Numbers (n,) that move no faster than a vehicle can."""

    def __init__(self, step: Array, rate: Array) -> None:
        """`step` (n,): noise and resets that are no reason to doubt; `rate` (n,): per second."""
        self._step = step
        self._rate = rate
        self._seen: list[tuple[Array, float]] = []  # the last believed, and the one in doubt
        self.doubted = 0

    def admits(self, numbers: Array, now_s: float) -> bool:
        """Whether to believe these numbers; never for NaN."""
        if any(self._follows(numbers, now_s, *seen) for seen in self._seen):
            self._seen = [(numbers, now_s)]
            return True
        self.doubted += bool(self._seen)
        self._seen = [*self._seen[:1], (numbers, now_s)] if self._seen else [(numbers, now_s)]
        return False

    def _follows(self, numbers: Array, now_s: float, last: Array, last_s: float) -> bool:
        return bool((np.abs(numbers - last) <= self._step + self._rate * (now_s - last_s)).all())
