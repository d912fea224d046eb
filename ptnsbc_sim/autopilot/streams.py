"""Which messages a link gets how often."""

from __future__ import annotations

import math
from collections.abc import Mapping

DEFAULT_INTERVAL, DISABLED = 0, -1


class Streams:
    """Messages due on one link, by id and rate [Hz]."""

    def __init__(self, rates_hz: Mapping[int, float], t: float) -> None:
        self._defaults = {i: 1.0 / rate for i, rate in rates_hz.items()}
        self._period = dict(self._defaults)
        # Spread the first ones, so that not everything falls into the same tick for ever.
        self._due = {
            i: t + period * ((index % 7) / 7.0)
            for index, (i, period) in enumerate(self._period.items())
        }
        self._next = min(self._due.values(), default=math.inf)

    def set_interval(self, message_id: int, interval_us: float, t: float) -> None:
        """SET_MESSAGE_INTERVAL: microseconds, 0 for the default, -1 for never."""
        self._period.pop(message_id, None)
        self._due.pop(message_id, None)
        period = interval_us * 1e-6
        if interval_us == DEFAULT_INTERVAL:
            period = self._defaults.get(message_id, 0.0)
        if period > 0.0:
            self._period[message_id] = period
            self._due[message_id] = t + period
        self._next = min(self._due.values(), default=math.inf)

    def interval_us(self, message_id: int) -> int:
        """As in MESSAGE_INTERVAL: -1 when not sent."""
        period = self._period.get(message_id)
        return DISABLED if period is None else round(period * 1e6)

    def due(self, t: float) -> list[int]:
        """Ids whose turn has come; after a pause each comes once."""
        if t < self._next:
            return []
        out = []
        for i, due in self._due.items():
            if t >= due:
                out.append(i)
                period = self._period[i]
                self._due[i] = due + period if t - due < period else t + period
        self._next = min(self._due.values())
        return out
