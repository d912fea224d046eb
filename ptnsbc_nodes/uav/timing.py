"""The clock, the ticks and the periods of a UAV process, in real time and in lock-step."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.diagnostics import status_every
from ptnsbc_nodes.comm.door import LockstepHorizon, LockstepStamps, RealTimeStamps, StampRule
from ptnsbc_nodes.comm.graph import LEAD_TICKS
from ptnsbc_nodes.runtime.pacing import ClockOffsetMonitor, Pace, Ticker
from ptnsbc_sim.scenario import Scenario


class UavTiming:
    """The clock, the ticks and the periods of one UAV."""

    def __init__(
        self, node: Node, scenario: Scenario, topic_names: list[str], lockstep: bool
    ) -> None:
        self._node = node
        self._lockstep = lockstep
        # The queues keep as many ticks, see `inbox`.
        self._horizon = LockstepHorizon((LEAD_TICKS + 2) * scenario.timing.dt_ns)
        self.period_ns = scenario.timing.dt_ns
        self.near_every = scenario.near_every
        self.status_every = status_every(scenario)
        self.start_ns = self.now_ns()
        self.done_ns = -1  # stamp of the newest tick
        self.pace = Pace(self.period_ns)
        self.clock_offset = ClockOffsetMonitor(topic_names)
        self._ticker: Ticker | None = None

    def now_ns(self) -> int:
        """The time of the node's clock."""
        return int(self._node.get_clock().now().nanoseconds)

    def stamp_rule(self) -> StampRule:
        """The rule for the stamps of a new sender."""
        if self._lockstep:
            return LockstepStamps(self._horizon, self.period_ns)
        return RealTimeStamps(self.now_ns)

    def done(self, now_ns: int) -> None:
        """The tick at `now_ns` is done."""
        self.done_ns = now_ns
        self._horizon.move(now_ns)

    def start(self, on_tick: Callable[[], None]) -> None:
        """Real time: tick once per period."""
        self.pace = Pace(self.period_ns)
        self._ticker = Ticker(self._node, self.period_ns, on_tick)

    def align(self, own: Stamped | None) -> None:
        """Real time: tick a little after the arrival of the own odometry."""
        if self._ticker is not None and own is not None:
            self._ticker.align(own.stamp_ns)

    def stop(self) -> None:
        """Tick no longer."""
        if self._ticker is not None:
            self._ticker.close()
            self._ticker = None
