"""One UAV on ROS 2: bytes in, one call of `Agent.step` per tick, bytes out.

In real time a node-clock timer ticks at the control rate with the newest of everything. In
lock-step a tick happens when all that it needs is here: own odometry of tick k, the neighbours'
messages of k-1.
"""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ptnsbc_io.wire import Stamped, decode_header, decode_near, decode_odometry
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.diagnostics import (
    INACTIVE,
    STATUS_HZ,
    DiagnosticLevel,
    diagnostics,
    readiness,
    status_every,
)
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.legs import EpochError, Epochs
from ptnsbc_nodes.comm.topics import LOST, READY
from ptnsbc_nodes.comm.vehicle_messages import decode_limits, limited
from ptnsbc_nodes.runtime.clock_offset import ClockOffsetMonitor
from ptnsbc_nodes.runtime.pacing import Pace, Ticker
from ptnsbc_nodes.uav.controller import UavController, moment
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS, Hear
from ptnsbc_nodes.uav.leg_services import LegServiceCallbacks, LegServices
from ptnsbc_nodes.uav.outbox import Outbox, StepLogPublisher
from ptnsbc_sim.scenario import Scenario, agent_config


class UavNode:
    """The controller of one UAV: one rclpy node, one tick; it only listens until `activate`."""

    def __init__(
        self, node: Node, scenario: Scenario, uav_id: int, edges: CommunicationGraph
    ) -> None:
        self.node = node
        self.endpoints = Endpoints(node, edges.options.lockstep)
        self._name = f"uav{uav_id}"
        self._lockstep = edges.options.lockstep
        self._recorded = edges.options.recorded
        self._carried = edges.options.bridged  # to its start by a bridge, until the first leg
        self._period_ns = scenario.dt_ns
        self._near_every = scenario.near_every
        self._status_every = status_every(scenario)
        self._pilot = UavController(agent_config(scenario, uav_id), edges.senders(uav_id))
        self._inbox = self._pilot.inbox
        self._outbox = Outbox(self.endpoints, edges, uav_id)
        self._epochs = Epochs()
        self._pace = Pace(self._period_ns)
        self._clocks = ClockOffsetMonitor(self._inbox.names(uav_id))
        self._done_ns = (
            self._seen_ns
        ) = -1  # stamp of the newest tick done, now and at the last look
        self._active = False
        self._missed_told = 0
        self._born_ns = self._clock_ns()
        self._subscribe(uav_id, edges)
        self._status = self.endpoints.publisher(topics.DIAGNOSTICS, edges.options.recorders)
        self._early_status = self.endpoints.publisher(READY, 0)
        leads = uav_id == scenario.leader_id
        self._services = self._serve(edges) if leads else None
        self._listeners = edges.epoch_listeners() if leads else {}
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._status_timer = node.create_timer(1.0 / STATUS_HZ, self._on_status_timer, clock=steady)
        self._ticker: Ticker | None = None
        self._notes = None
        if not self._lockstep:
            self._notes = StepLogPublisher(self.endpoints, edges, uav_id, scenario.control_hz)

    def activate(self) -> None:
        """Begin to tick. In real time control begins anew, where the vehicle is by then."""
        self._active = True
        if not self._lockstep:
            self._pilot.restart()
            self._pace = Pace(self._period_ns)
            self._ticker = Ticker(self.node, self._period_ns, self._on_tick_timer)
        self._advance()

    def deactivate(self) -> None:
        """Send nothing but diagnostics; go on listening."""
        self._active = False
        if self._ticker is not None:
            self._ticker.close()
            self._ticker = None

    def close(self) -> None:
        """Take everything away from the node."""
        self.deactivate()
        self.node.destroy_timer(self._status_timer)
        if self._services is not None:
            self._services.close()
        self.endpoints.close()

    def waiting_for(self) -> list[str]:
        """Topics without their other end; in real time also an odometry not heard yet.

        What is to be recorded from the first leg on must have found its recorder; in flight a
        recorder that ends, or a child, is no reason to wait.
        """
        missing = self.endpoints.unheard()
        if not self._active:
            missing.append(INACTIVE)
        if self._lockstep:
            return missing + self.endpoints.unread()
        if self._recorded and not self._epochs.announced:
            missing += self.endpoints.unread() + self.endpoints.unmatched(
                topics.EPOCH, self._listeners
            )
        if self._inbox.own is None and self._odom_name not in missing:
            missing.append(self._odom_name)
        if self._clocks.offset is not None and not self._epochs.announced:
            missing.append(f"another time: {self._clocks.offset}")
        return missing

    def _subscribe(self, uav_id: int, edges: CommunicationGraph) -> None:
        listen = self.endpoints.listen
        self._odom_name = listen(topics.odom(uav_id), self._on_odom)
        listen(topics.near(uav_id), self._on_near, required=self._lockstep)
        for topic, hear in self._inbox.ears().items():
            listen(topic, self._hearer(hear))
        listen(topics.EPOCH, self._on_epoch)
        listen(LOST, self._on_lost, required=False)
        if self._carried:
            listen(topics.limits(uav_id), self._on_limits)

    def _serve(self, edges: CommunicationGraph) -> LegServices:
        instruments = LegServiceCallbacks(
            publish=self.endpoints.publisher(topics.EPOCH, edges.epoch_readers()),
            now_ns=self._flight_ns,
            epochs=self._epochs,
            waiting_for=self.waiting_for,
        )
        return LegServices(self.node, self.endpoints.fleet, instruments, self._lockstep)

    def _clock_ns(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def _flight_ns(self) -> int:
        return max(self._done_ns, 0) if self._lockstep else self._clock_ns()

    def _on_odom(self, data: bytes) -> None:
        self._inbox.own = decode_odometry(data)
        self._advance()

    def _on_near(self, data: bytes) -> None:
        self._inbox.near = decode_near(data)
        self._advance()

    def _hearer(self, hear: Hear) -> Callable[[bytes], None]:
        advance = self._advance

        def on_message(data: bytes) -> None:
            hear(decode_odometry(data))
            advance()

        return on_message

    def _on_epoch(self, data: bytes) -> None:
        t0_ns, leg = decode_header(data)
        if not self._lockstep:
            self.endpoints.begin(self._clock_ns())
        if self._ticker is not None and self._inbox.own is not None:
            self._ticker.align(self._inbox.own.stamp_ns)
        try:
            self._epochs.announce(t0_ns, leg)
        except EpochError as error:
            self.node.get_logger().error(str(error))
        self._advance()

    def _on_lost(self, data: bytes) -> None:
        name = decode_header(data).frame_id.removeprefix("uav")
        if name.isdecimal():
            self._inbox.lose(int(name))
        self._advance()

    def _on_limits(self, data: bytes) -> None:
        """What the vehicle can do, before its formation begins."""
        self._pilot.config = limited(self._pilot.config, *decode_limits(data))

    def _advance(self) -> None:
        """Lock-step: do the tick if everything for it is here."""
        own = self._inbox.own
        if not self._lockstep or own is None or own.stamp_ns <= self._done_ns or not self._active:
            return
        if self._inbox.holds_tick(self._period_ns, self._near_every) and self._epochs.announced:
            now_ns = own.stamp_ns
            self._tick(own, now_ns, now_ns, self._period_ns)
            if now_ns // self._period_ns % self._status_every == 0:
                self._report(now_ns)

    def _on_tick_timer(self) -> None:
        now_ns = self._clock_ns()
        periods = self._pace.tick(now_ns)
        self._clocks.look(now_ns, self._inbox.held(NO_CUTOFF_NS))
        own = self._inbox.own
        # The setpoint is the proof of life: without fresh odometry there must be none.
        if own is not None and not self._stale(own, now_ns):
            self._tick(own, now_ns, NO_CUTOFF_NS, periods * self._period_ns)

    def _stale(self, own: Stamped, now_ns: int) -> bool:
        return (now_ns - own.stamp_ns) * 1e-9 > self._pilot.config.stale_s

    def _tick(self, own: Stamped, now_ns: int, cutoff_ns: int, elapsed_ns: int) -> None:
        leg = self._epochs.at(now_ns)
        if leg is None:  # not announced or still to come
            self._pace.missed = 0
        elif self._carried:
            self._carried = False
            self._pilot.restart()
        at = moment(now_ns, elapsed_ns, leg, self._born_ns)
        outputs = self._pilot.step(at, cutoff_ns)
        self._done_ns = now_ns
        self._outbox.send(own, outputs)
        if self._notes is not None:
            self._notes.send(at, self._pilot)

    def _on_status_timer(self) -> None:
        if not self._lockstep:
            self._report(self._clock_ns())
        elif self._done_ns in (-1, self._seen_ns):  # not begun, or kept waiting: a sign of life
            self._report(-1)
        self._seen_ns = self._done_ns

    def _report(self, stamp_ns: int) -> None:
        missing = self.waiting_for() if stamp_ns < 0 or not self._lockstep else []
        leg = self._epochs.at(stamp_ns)
        values = {
            **readiness(missing),
            "mode": leg.name if leg else "waiting",
            "missed_ticks": str(self._pace.missed),
            **self._pilot.tally.values(),
        }
        level, message = self._verdict(stamp_ns, missing)
        send = self._status if stamp_ns >= 0 else self._early_status
        send(diagnostics(max(stamp_ns, 0), f"{self._name}: planner", level, message, values))

    def _verdict(self, stamp_ns: int, missing: list[str]) -> tuple[DiagnosticLevel, str]:
        own = self._inbox.own
        if not self._active:
            return DiagnosticLevel.WARN, "inactive"
        if not self._lockstep and own is not None and self._stale(own, stamp_ns):
            told = "own odometry is stale: no setpoints"
            offset = self._clocks.offset
            return DiagnosticLevel.ERROR, told if offset is None else f"{told}; {offset}"
        if self._clocks.offset is not None:
            return DiagnosticLevel.WARN, str(self._clocks.offset)
        if self._epochs.announced and self._pilot.tally.holding:
            return DiagnosticLevel.WARN, "holding"
        missed, self._missed_told = self._pace.missed - self._missed_told, self._pace.missed
        if missed > 0:
            return DiagnosticLevel.WARN, f"{missed} ticks missed since the last status"
        return (
            (DiagnosticLevel.WARN, f"waiting for {' '.join(missing)}")
            if missing
            else (DiagnosticLevel.OK, "")
        )
