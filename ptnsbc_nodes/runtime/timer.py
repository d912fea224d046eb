"""The real-time tick: a node-clock timer that can be set a little behind somebody else's."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from rclpy.timer import Timer

NANOSECONDS = 1e9
_SHORTEST_NS = 1_000
_BEHIND = 0.3  # of a period: time for the message to arrive, and for the answer to be in time


def delay_ns(now_ns: int, stamp_ns: int, period_ns: int) -> int:
    """Time from `now_ns` to the next instant `_BEHIND` periods behind the grid of a stamp."""
    return (stamp_ns + int(_BEHIND * period_ns) - now_ns) % period_ns


class Ticker:
    """Calls back once per period.

    Two free-running timers of the same rate keep whatever phase they happened to start with. An
    unlucky UAV would then answer every odometry just too late, a whole period later than others.
    """

    def __init__(self, node: Node, period_ns: int, callback: Callable[[], None]) -> None:
        self._node = node
        self._period_ns = period_ns
        self._timer = node.create_timer(period_ns / NANOSECONDS, callback)
        self._once: Timer | None = None

    def align(self, stamp_ns: int) -> None:
        """Tick a little after messages stamped like this one, from now on."""
        now_ns = int(self._node.get_clock().now().nanoseconds)
        wait_ns = max(delay_ns(now_ns, stamp_ns, self._period_ns), _SHORTEST_NS)
        self._once = self._node.create_timer(wait_ns / NANOSECONDS, self._shift)

    def close(self) -> None:
        """Tick no more."""
        for timer in (self._timer, self._once):
            if timer is not None:
                self._node.destroy_timer(timer)

    def _shift(self) -> None:
        if self._once is not None:
            self._once.cancel()
        self._timer.reset()
