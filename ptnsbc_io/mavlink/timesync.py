"""The vehicle's clock against ours, by TIMESYNC; without answers, by the quickest messages.

Both clocks are monotonic ones: ours the steady clock of this host, the vehicle's the time since its
boot that every message carries. What NTP does to the wall clock does not matter here.
"""

from __future__ import annotations

from collections import deque

_NANO = 1e-9
_ROUNDING_S = 1e-6
_SLOWEST_TRIP_S = 0.5
_WINDOW = 16
_ONE_WAY_WINDOW_S = 5.0
_JUMP_S = 0.5
_JUMP_SAMPLES = 3
_PATIENCE_S = 5.0


class TimeSync:
    """Offset between the vehicle's clock and ours, from round trips."""

    def __init__(self) -> None:
        self._trips: deque[tuple[float, float]] = deque(maxlen=_WINDOW)  # (round trip, offset) [s]
        self._one_way: deque[tuple[float, float]] = deque()  # (arrival, offset) [s]
        self._asked_ns: deque[int] = deque(maxlen=_WINDOW)
        self._first_s: float | None = None
        self._strangers = 0
        self.jumps = 0
        self.answers = 0

    @property
    def synchronised(self) -> bool:
        """Whether round trips are known; False while one-way times must do."""
        return bool(self._trips)

    @property
    def round_trip_s(self) -> float:
        """The shortest round trip of late; 0 while none is known."""
        return min((trip for trip, _ in self._trips), default=0.0)

    def ask(self, now_s: float) -> int:
        """The stamp [ns] to send as ts1."""
        stamp_ns = round(now_s / _NANO)
        self._asked_ns.append(stamp_ns)
        return stamp_ns

    def answered(self, theirs_ns: int, ours_ns: int, now_s: float) -> bool:
        """Take an answer (tc1, ts1) in; False for one that answers nothing we asked."""
        if ours_ns not in self._asked_ns:
            return False
        self._asked_ns.remove(ours_ns)  # each question has one answer; a second is a replay
        trip_s = now_s - ours_ns * _NANO
        if not -_ROUNDING_S <= trip_s <= _SLOWEST_TRIP_S:
            return False
        offset_s = 0.5 * (ours_ns * _NANO + now_s) - theirs_ns * _NANO
        self.answers += 1
        if self._trips and abs(offset_s - self._offset_of_trips()) > _JUMP_S + trip_s:
            self._strangers += 1
            if self._strangers < _JUMP_SAMPLES:
                return False
            self.forget()
            self.jumps += 1
        self._strangers = 0
        self._trips.append((trip_s, offset_s))
        return True

    def heard(self, boot_s: float, now_s: float) -> None:
        """Any message with the time since boot: a bound for the offset from one side."""
        if self._first_s is None:
            self._first_s = now_s
        self._one_way.append((now_s, now_s - boot_s))
        while now_s - self._one_way[0][0] > _ONE_WAY_WINDOW_S:
            self._one_way.popleft()

    def ready(self, now_s: float) -> bool:
        """Whether times can be converted: by round trips, or after waiting for them in vain."""
        if self._trips:
            return True
        return self._first_s is not None and now_s - self._first_s > _PATIENCE_S

    def ours(self, boot_s: float) -> float | None:
        """The instant on our steady clock [s] of a time since boot; None before anything is known."""
        if self._trips:
            return boot_s + self._offset_of_trips()
        if self._one_way:
            return boot_s + min(offset for _, offset in self._one_way)
        return None

    def forget(self) -> None:
        """Start again: the vehicle's clock is another one now."""
        self._trips.clear()
        self._one_way.clear()
        self._strangers = 0
        self._first_s = None

    def _offset_of_trips(self) -> float:
        # The quickest trip was held up least, so its middle is the truest.
        return min(self._trips)[1]
