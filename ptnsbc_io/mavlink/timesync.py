"""The vehicle's clock: its offset to ours by TIMESYNC, or without answers by the fastest messages; and its restarts.

Both clocks are monotonic: ours is the steady clock of this host, the vehicle's is the time since its
boot that every message carries. Steps of the wall clock by NTP have no effect.
"""

from __future__ import annotations

from collections import deque

from ptnsbc_core.nanoseconds import nanoseconds, seconds

_ROUNDING_S = 1e-6
_SLOWEST_TRIP_S = 0.5
_WINDOW = 16
_ONE_WAY_WINDOW_S = 5.0
_JUMP_S = 0.5
_JUMP_SAMPLES = 3
_ANSWER_TIMEOUT_S = 5.0
_BACKWARDS_S = 0.5
_YOUNG_S = 60.0  # a clock that shows more has not just begun
_DUPLICATE_STEPS, _DUPLICATE_WINDOW_S = 3, 3.0


class TimeSync:
    """Offset between the vehicle's clock and ours, from round trips."""

    def __init__(self) -> None:
        self._trips: deque[tuple[float, float]] = deque(maxlen=_WINDOW)  # (round trip, offset) [s]
        self._one_way: deque[tuple[float, float]] = deque()  # (arrival, offset) [s]
        self._requested_ns: deque[int] = deque(maxlen=_WINDOW)
        self._first_s: float | None = None
        self._jump_samples = 0
        self.answers = 0

    @property
    def synchronised(self) -> bool:
        """True if round trips are known; False while the offset is from one-way times."""
        return bool(self._trips)

    @property
    def round_trip_s(self) -> float:
        """The shortest of the recent round trips; 0 while none is known."""
        # In one step: another thread asks than that which takes the answers.
        return min(self._trips, default=(0.0, 0.0))[0]

    def request(self, now_s: float) -> int:
        """The stamp [ns] to send as ts1."""
        stamp_ns = nanoseconds(now_s)
        self._requested_ns.append(stamp_ns)
        return stamp_ns

    def on_answer(self, theirs_ns: int, ours_ns: int, now_s: float) -> bool:
        """Take an answer (tc1, ts1); False when it answers none of our requests."""
        if ours_ns not in self._requested_ns:
            return False
        self._requested_ns.remove(ours_ns)  # each request has one answer; a second one is a replay
        trip_s = now_s - seconds(ours_ns)
        if not -_ROUNDING_S <= trip_s <= _SLOWEST_TRIP_S:
            return False
        offset_s = 0.5 * (seconds(ours_ns) + now_s) - seconds(theirs_ns)
        self.answers += 1
        if self._trips and abs(offset_s - self._round_trip_offset()) > _JUMP_S + trip_s:
            self._jump_samples += 1
            if self._jump_samples < _JUMP_SAMPLES:
                return False
            self.reset()
        self._jump_samples = 0
        self._trips.append((trip_s, offset_s))
        return True

    def on_boot_time(self, boot_s: float, now_s: float) -> None:
        """Take the time since boot of any message: a bound of the offset from one side."""
        if self._first_s is None:
            self._first_s = now_s
        self._one_way.append((now_s, now_s - boot_s))
        while now_s - self._one_way[0][0] > _ONE_WAY_WINDOW_S:
            self._one_way.popleft()

    def ready(self, now_s: float) -> bool:
        """True if times can be converted: by round trips, or after 5 s without any."""
        if self._trips:
            return True
        return self._first_s is not None and now_s - self._first_s > _ANSWER_TIMEOUT_S

    def to_host_time(self, boot_s: float) -> float | None:
        """The instant on our steady clock [s] of a time since boot; None before anything is known."""
        if self._trips:
            return boot_s + self._round_trip_offset()
        if self._one_way:
            return boot_s + min(offset for _, offset in self._one_way)
        return None

    def reset(self) -> None:
        """Start again with a new clock of the vehicle."""
        self._trips.clear()
        self._one_way.clear()
        self._jump_samples = 0
        self._first_s = None

    def _round_trip_offset(self) -> float:
        # The fastest round trip was delayed least, so its middle is the most accurate.
        return min(self._trips)[1]


class VehicleClock:
    """The vehicle's time since boot: notices when it begins anew, and when it jumps to and fro."""

    def __init__(self) -> None:
        self._newest: tuple[float, float] | None = None  # time since boot, and when it arrived
        self._unexpected_s: float | None = None  # a time since boot that does not follow it
        self.restarted_s: float | None = None
        self._backward_steps: deque[float] = deque(maxlen=_DUPLICATE_STEPS)

    def update(self, boot_s: float, now_s: float) -> bool:
        """Take a time since boot; returns whether it stepped back once.

        One step back is an accident; two in a row are another boot. Messages that were held up make no
        step: they arrive late, but in their order.
        """
        last_s, arrived_s = self._newest or (boot_s, now_s)
        step_s, elapsed_s = boot_s - last_s, now_s - arrived_s
        if -_BACKWARDS_S <= step_s <= elapsed_s + _BACKWARDS_S:
            self._newest, self._unexpected_s = (boot_s, now_s), None
            return False
        went_back = step_s < 0.0
        before_s, self._unexpected_s = self._unexpected_s, boot_s
        if before_s is not None and abs(boot_s - before_s) < _BACKWARDS_S:
            # A clock that shows its old time again has not begun anew: forged messages looked like it.
            self.restarted_s = now_s if went_back and boot_s < _YOUNG_S else None
            self._newest, self._unexpected_s = (boot_s, now_s), None
            return False
        if went_back:
            self._backward_steps.append(now_s)
        return went_back

    @property
    def young(self) -> bool:
        """True if the vehicle has not been up for long, by its own clock; False while that is not known."""
        return self._newest is not None and self._newest[0] < _YOUNG_S

    def jumps_to_and_fro(self, now_s: float) -> bool:
        """True if the time has stepped back several times just now."""
        steps = self._backward_steps
        return len(steps) == _DUPLICATE_STEPS and now_s - steps[0] <= _DUPLICATE_WINDOW_S
