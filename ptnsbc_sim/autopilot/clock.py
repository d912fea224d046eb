"""The clock of an autopilot: counts from its boot, and may jump."""

from __future__ import annotations


class BootClock:
    """Time since boot, from the host's time handed in."""

    def __init__(self, t: float) -> None:
        self._boot_t = t
        self._jump_s = 0.0

    def reboot(self, t: float) -> None:
        """Start again at zero."""
        self._boot_t, self._jump_s = t, 0.0

    def jump(self, seconds: float) -> None:
        """Move by some seconds from now on."""
        self._jump_s += seconds

    def seconds(self, t: float) -> float:
        """Time since boot [s]."""
        return max(0.0, t - self._boot_t + self._jump_s)

    def ms(self, t: float) -> int:
        """Time since boot [ms], as in time_boot_ms."""
        return int(self.seconds(t) * 1e3) & 0xFFFFFFFF

    def us(self, t: float) -> int:
        """Time since boot [us], as in time_usec."""
        return int(self.seconds(t) * 1e6)

    def ns(self, t: float) -> int:
        """Time since boot [ns], as in TIMESYNC."""
        return int(self.seconds(t) * 1e9)
