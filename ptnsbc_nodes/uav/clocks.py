"""The two clocks of a UAV process: when a tick is due, which messages count at it, and which stamps are taken.

In real time a timer ticks at the control rate, and the newest messages count. In lock-step a tick is due when its
messages are here: the own odometry of tick k, and the neighbours' messages of k-1. One of tick k that arrives before
the tick does not replace that of k-1.
"""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.door import LockstepStamps, RealTimeStamps
from ptnsbc_nodes.comm.graph import LEAD_TICKS, Senders
from ptnsbc_nodes.runtime.pacing import ClockOffsetMonitor, Pace, Ticker, clock_of
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_nodes.uav.uav_controller import StepTime, UavFlight, step_time
from ptnsbc_sim.counters import status_every
from ptnsbc_sim.scenario import Scenario

_COMPARED_NS = 100_000_000
"""Between two looks at the clocks of others."""
LEAD_NS = 500_000_000
"""An epoch is announced this long before it begins, so that all UAVs switch at the same instant [ns]."""


class RealTimeClock:
    """The clock of the node, whose timer ticks."""

    lockstep = False

    def __init__(self, node: Node, scenario: Scenario) -> None:
        self._node = node
        self.now_ns = self.next_ns = clock_of(node)
        self._period_ns = scenario.timing.dt_ns
        self._start_ns = self.now_ns()
        self.pace = Pace(scenario.timing.dt_ns)
        self._ticker: Ticker | None = None
        self._compared: Senders | None = None  # those whose clocks are compared with ours
        self._offsets = ClockOffsetMonitor(())
        self._compared_ns = 0

    def epoch_ns(self, *, first: bool, at_once: bool) -> int:
        """The epoch of a leg that is announced now."""
        return self.now_ns() + (0 if at_once else LEAD_NS)

    def stamp_rule(self) -> RealTimeStamps:
        """The rule for the stamps of a new sender."""
        return RealTimeStamps(self.now_ns)

    def start(self, on_tick: Callable[[], None]) -> None:
        """Tick once per period from now on."""
        self.pace = Pace(self._period_ns)
        self._ticker = Ticker(self._node, self._period_ns, on_tick)

    def align(self, own: Stamped | None) -> None:
        """Tick a little after the arrival of the own odometry."""
        if self._ticker is not None and own is not None:
            self._ticker.align(own.stamp_ns)

    def cutoff_ns(self, at: StepTime) -> int:
        """A neighbour's message must be stamped before to count at a step."""
        return NO_CUTOFF_NS

    def due(self, flight: UavFlight) -> StepTime | None:
        """The step of the timer; None without fresh odometry: a setpoint proves that the controller has it."""
        now_ns, inbox = self.now_ns(), flight.inbox
        elapsed_ns = self.pace.tick(now_ns) * self._period_ns
        if self._compared is not inbox.senders:
            self._compared = inbox.senders
            self._offsets = ClockOffsetMonitor(inbox.topic_names(flight.uav))
        if not 0 <= now_ns - self._compared_ns < _COMPARED_NS:
            self._compared_ns = now_ns
            self._offsets.look(now_ns, inbox.held(NO_CUTOFF_NS, NO_CUTOFF_NS))
        if inbox.own is None or flight.controller.odometry_stale(now_ns):
            return None
        return step_time(now_ns, elapsed_ns, flight.leg(now_ns), self._start_ns)

    def done(self, at: StepTime) -> bool:
        """A step is done; returns whether a status follows it at once."""
        return False

    @property
    def offset(self) -> str:
        """The clock that differs most from ours, in words; empty while none differs much."""
        return self._offsets.offset

    def status_ns(self) -> int | None:
        """The instant of the status that is due by wall time."""
        return self.now_ns()


class LockstepClock:
    """The stamps of the odometry, which the simulation gives."""

    lockstep = True
    offset = ""

    def __init__(self, scenario: Scenario) -> None:
        self._period_ns, self._near_every = scenario.timing.dt_ns, scenario.near_every
        self._status_every_ns = status_every(scenario) * scenario.timing.dt_ns
        self.pace = Pace(scenario.timing.dt_ns)  # of no timer: nothing is missed
        self._done_ns = self._seen_ns = -1  # newest tick, now and at the last look

    def now_ns(self) -> int:
        """Time of the flight."""
        return max(self._done_ns, 0)

    def next_ns(self) -> int:
        """Time of the flight that no tick has reached yet."""
        return self.now_ns() + self._period_ns

    def epoch_ns(self, *, first: bool, at_once: bool) -> int:
        """The epoch of a leg that is announced now: simulated time starts with the first."""
        return 0 if first else self.now_ns() + LEAD_NS

    def stamp_rule(self) -> LockstepStamps:
        """The rule for the stamps of a new sender."""
        # The queues keep as many ticks, see `inbox`.
        lead_ns = (LEAD_TICKS + 2) * self._period_ns
        return LockstepStamps(lambda: self.now_ns() + lead_ns, self._period_ns)

    def start(self, on_tick: Callable[[], None]) -> None:
        """Messages make the ticks; those of the first may be here."""
        on_tick()

    def align(self, own: Stamped | None) -> None:
        """There is no timer to align."""

    def cutoff_ns(self, at: StepTime) -> int:
        """A neighbour's message must be stamped before to count at a step."""
        return at.now_ns

    def due(self, flight: UavFlight) -> StepTime | None:
        """The step of the newest odometry, once everything for it is here."""
        own = flight.inbox.own
        if own is None or own.stamp_ns <= self._done_ns or not flight.epochs.announced:
            return None
        at = step_time(own.stamp_ns, self._period_ns, flight.leg(own.stamp_ns), 0)
        if flight.faults.plays_dead(at.now_ns):
            flight.controller.forget()
            self.done(at)
            return None
        if not flight.take_slot(at):
            return None  # the decision is on its way
        return at if flight.inbox.holds_tick(self._period_ns, self._near_every) else None

    def done(self, at: StepTime) -> bool:
        """A step is done; returns whether a status follows it at once."""
        self._done_ns = at.now_ns
        return at.now_ns % self._status_every_ns == 0

    def status_ns(self) -> int | None:
        """-1 while the flight has not begun or the UAV waits for others: the launcher learns that it is alive."""
        waits = self._done_ns in (-1, self._seen_ns)
        self._seen_ns = self._done_ns
        return -1 if waits else None


UavClock = RealTimeClock | LockstepClock
