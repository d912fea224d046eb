"""The boot clock of an autopilot, and the messages that are due on a link."""

from __future__ import annotations

import math
from collections.abc import Mapping

_DEFAULT_INTERVAL, _DISABLED = 0, -1  # of SET_MESSAGE_INTERVAL


class BootClock:
    """Time since boot, from the host's time; a fault can make it jump."""

    def __init__(self, t: float) -> None:
        self._boot_t = t
        self._jump_s = 0.0

    def reboot(self, t: float) -> None:
        """Start again at zero."""
        self._boot_t, self._jump_s = t, 0.0

    def jump(self, seconds: float) -> None:
        """Move the clock by some seconds."""
        self._jump_s += seconds

    def _seconds(self, t: float) -> float:
        return max(0.0, t - self._boot_t + self._jump_s)

    def ms(self, t: float) -> int:
        """Time since boot [ms], as in time_boot_ms."""
        return int(self._seconds(t) * 1e3) & 0xFFFFFFFF

    def us(self, t: float) -> int:
        """Time since boot [us], as in time_usec."""
        return int(self._seconds(t) * 1e6)

    def ns(self, t: float) -> int:
        """Time since boot [ns], as in TIMESYNC."""
        return int(self._seconds(t) * 1e9)


class MessageStreams:
    """The messages streamed on one link, by id and rate [Hz]."""

    def __init__(self, rates_hz: Mapping[int, float], t: float) -> None:
        self._defaults = {i: 1.0 / rate for i, rate in rates_hz.items()}
        self._period = dict(self._defaults)
        # The first ones are spread, so that they do not share a tick for ever.
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
        if interval_us == _DEFAULT_INTERVAL:
            period = self._defaults.get(message_id, 0.0)
        if period > 0.0:
            self._period[message_id] = period
            self._due[message_id] = t + period
        self._next = min(self._due.values(), default=math.inf)

    def interval_us(self, message_id: int) -> int:
        """As in MESSAGE_INTERVAL: -1 when the message is not streamed."""
        period = self._period.get(message_id)
        return _DISABLED if period is None else round(period * 1e6)

    def due(self, t: float) -> list[int]:
        """Ids that are due at t [s]; after a pause each is due once."""
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
