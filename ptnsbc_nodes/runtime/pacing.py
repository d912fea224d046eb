"""Time in a process: the tick in real time, missed ticks, latencies, the speed of a flight, the clocks of senders.

All times of a flight count from one epoch, by the clock of each computer. So the clocks must agree: a computer
that is ahead begins earlier, and takes every message for an old one, beyond `communication.stale_s` for a stale one.

The least age at which messages of one sender arrive is the delay of the network plus how far our clock is ahead.
The delay of a network that can carry a flight is small.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ptnsbc_core.nanoseconds import SECOND_NS, seconds
from ptnsbc_io.wire import Stamped

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.timer import Timer

_SHORTEST_NS = 1_000
_ALIGNED_S = 1.0
_BEHIND = 0.3  # of a period: time for the message to arrive, and for the answer to be in time
_LATENCY_WINDOW = 5000
_PROGRESS_S = 2.0
LIMIT_S = 0.1
"""Clocks that are so far apart are reported."""
_WINDOW_S = 0.5


def clock_of(node: Node) -> Callable[[], int]:
    """The time [ns] of a node's clock: that of the system, or with `use_sim_time` that of /clock.

    A look at rclpy's own clock makes objects. That was a tenth of what a UAV process took.
    """
    if node.get_parameter("use_sim_time").value:
        return lambda: int(node.get_clock().now().nanoseconds)
    return time.time_ns


class Pace:
    """Counts the ticks that a timer has missed: those a period or more too late."""

    def __init__(self, period_ns: int) -> None:
        self.missed = 0
        self._period_ns = period_ns
        self._due_ns: int | None = None

    def tick(self, now_ns: int) -> int:
        """Periods that have passed since the last tick, at least 1; more than 1 were missed."""
        due_ns = self._due_ns
        if due_ns is None or now_ns < due_ns:
            due_ns = now_ns  # the grid starts at the earliest tick, not at a late one
        skipped = (now_ns - due_ns) // self._period_ns
        self.missed += skipped
        self._due_ns = due_ns + (skipped + 1) * self._period_ns
        return skipped + 1


class Latency:
    """Percentiles of the newest latencies, and the largest ever."""

    def __init__(self) -> None:
        self._recent_s = np.zeros(_LATENCY_WINDOW)  # a ring
        self.count = 0
        self.max_s = 0.0

    def add(self, latency_s: float) -> None:
        """Count one message."""
        self._recent_s[self.count % _LATENCY_WINDOW] = latency_s
        self.count += 1
        self.max_s = max(self.max_s, latency_s)

    def percentile_s(self, percent: float) -> float:
        """The percentile [s] over the newest messages; 0 before the first."""
        if not self.count:
            return 0.0
        known_s = np.sort(self._recent_s[: self.count])  # `np.percentile` loads 7 ms of modules
        return float(np.interp(percent, np.linspace(0.0, 100.0, len(known_s)), known_s))


class Progress:
    """A line on stderr now and then: simulated time and steps per second."""

    def __init__(self, control_hz: int, duration_s: float) -> None:
        self._control_hz, self._duration_s = control_hz, duration_s
        self._began = self._shown = 0.0
        self._shown_ticks = 0

    def begin(self) -> None:
        """The first tick."""
        self._began = time.monotonic()
        self._shown = self._began

    def show(self, ticks: int) -> None:
        """Print if it is time."""
        now = time.monotonic()
        if now - self._shown >= _PROGRESS_S:
            self._print(ticks, (ticks - self._shown_ticks) / (now - self._shown))
            self._shown, self._shown_ticks = now, ticks

    def end(self, ticks: int) -> None:
        """Print the average of the flight."""
        self._print(ticks, ticks / max(time.monotonic() - self._began, 1e-9))

    def _print(self, ticks: int, rate: float) -> None:
        print(
            f"sim: {ticks / self._control_hz:.2f} of {self._duration_s:g} s, {rate:.0f} steps/s",
            file=sys.stderr,
            flush=True,
        )


def delay_ns(now_ns: int, stamp_ns: int, period_ns: int) -> int:
    """Time from `now_ns` to the next instant `_BEHIND` periods behind the grid of a stamp."""
    return (stamp_ns + int(_BEHIND * period_ns) - now_ns) % period_ns


class Ticker:
    """A node-clock timer of the control loop, whose phase can be set behind that of incoming messages.

    Two free-running timers of the same rate keep the phase that they started with. By chance a UAV would then
    answer every odometry just too late, a whole period later than others.
    """

    def __init__(self, node: Node, period_ns: int, callback: Callable[[], None]) -> None:
        self._node = node
        self._now_ns = clock_of(node)
        self._period_ns = period_ns
        self._timer = node.create_timer(period_ns / SECOND_NS, callback)
        self._once: Timer | None = None
        self._aligned_s = float("-inf")

    def align(self, stamp_ns: int) -> None:
        """From now on tick a little after messages with such a stamp.

        A shift delays one tick by less than a period. One that follows within `_ALIGNED_S` changes nothing: it would
        find the phase as it is, and many of them would delay the tick for ever.
        """
        now_s = time.monotonic()
        if now_s - self._aligned_s < _ALIGNED_S:
            return
        self._aligned_s = now_s
        if self._once is not None:
            self._node.destroy_timer(self._once)
        wait_ns = max(delay_ns(self._now_ns(), stamp_ns, self._period_ns), _SHORTEST_NS)
        self._once = self._node.create_timer(wait_ns / SECOND_NS, self._shift)

    def _shift(self) -> None:
        if self._once is not None:
            self._once.cancel()
        self._timer.reset()


class _Least:
    """The least age [s] of one sender's messages in the last one to two windows."""

    __slots__ = ("_before", "_now", "_since_ns", "_stamp_ns")

    def __init__(self) -> None:
        self._stamp_ns = -1
        self._since_ns = 0
        self._before: float | None = None
        self._now: float | None = None

    def add(self, now_ns: int, message: Stamped) -> None:
        if message.stamp_ns == self._stamp_ns:
            return
        self._stamp_ns = message.stamp_ns
        if seconds(now_ns - self._since_ns) > _WINDOW_S:
            self._before, self._now, self._since_ns = self._now, None, now_ns
        age_s = seconds(now_ns - message.stamp_ns)
        self._now = age_s if self._now is None else min(self._now, age_s)

    @property
    def age_s(self) -> float | None:
        """None before the end of the first window: its first message may have been late."""
        if self._before is None or self._now is None:
            return self._before
        return min(self._before, self._now)


class ClockOffsetMonitor:
    """Compares our clock with the stamps of messages."""

    def __init__(self, names: Sequence[str]) -> None:
        """`names`: of the topics, in the order of the messages in `look`."""
        self._names = tuple(names)
        self._least = [_Least() for _ in names]

    def look(self, now_ns: int, newest: Sequence[Stamped | None]) -> None:
        """Take in the newest message of each topic, None where there is none."""
        for least, message in zip(self._least, newest, strict=True):
            if message is not None:
                least.add(now_ns, message)

    @property
    def offset(self) -> str:
        """The clock farthest from ours in words; empty unless it is at least `LIMIT_S` away."""
        ages = ((least.age_s, name) for least, name in zip(self._least, self._names, strict=True))
        known = [(age_s, name) for age_s, name in ages if age_s is not None]
        # Our clock minus the sender's, plus the least delay of its messages.
        ahead_s, name = max(known, key=lambda of: abs(of[0]), default=(0.0, ""))
        if abs(ahead_s) < LIMIT_S:
            return ""
        return f"clock {abs(ahead_s):.2f} s {'ahead of' if ahead_s > 0 else 'behind'} {name}"
