"""The reference of every fleet: the same processes, topics, sizes, QoS and executor, and nothing else.

A process of this module publishes prebuilt messages of which it patches the stamp, and reads the
stamp of what it hears. No laws, no decoding, no bag; a fleet cannot be faster than this.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ptnsbc_nodes import environment, qos, topics
from ptnsbc_nodes.edges import Edges
from ptnsbc_nodes.endpoints import Endpoints
from ptnsbc_nodes.markers import Scene
from ptnsbc_nodes.pacing import Latency, Pace
from ptnsbc_nodes.process import Arguments, Lifetime, flight_options, ros_node, run
from ptnsbc_nodes.status import Level, diagnostics, status_every
from ptnsbc_nodes.tally import Tally
from ptnsbc_nodes.ticker import Ticker
from ptnsbc_nodes.topics import Topic
from ptnsbc_nodes.wire import (
    ClockTemplate,
    OdometryTemplate,
    VelocityTemplate,
    WrenchTemplate,
    encode_near,
    peek_stamp,
)
from ptnsbc_nodes.wire.cdr import write_stamp
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.world import World

READY = "ready"
ROLES = ("uav", "sim", "recorder")

_LOOK_S = 0.05
_NEAR_OBJECTS = 2
_FRAME = "map"

Send = Callable[[int], None]


def sender(endpoints: Endpoints, topic: Topic, readers: int, message: bytes) -> Send:
    """Publishes `message` with another stamp each time."""
    publish, buffer = endpoints.publisher(topic, readers), bytearray(message)

    def send(stamp_ns: int) -> None:
        write_stamp(buffer, stamp_ns)
        publish(bytes(buffer))

    return send


def _status(name: str) -> bytes:
    """A DiagnosticArray of the size of ours."""
    values = {key: "0.000000" for key in Tally().values()}
    return diagnostics(0, f"{name}: planner", Level.OK, "", values)


def when_ready(
    node: Node, endpoints: Endpoints, go: Path | None, begin: Callable[[], None]
) -> None:
    """Say that every topic has both ends; with `go` call `begin` when that file is there."""
    said = False

    def look() -> None:
        nonlocal said
        if not said and not endpoints.unheard() and not endpoints.unread():
            said = True
            print(READY, file=sys.stderr, flush=True)
        if said and (go is None or go.exists()):
            timer.cancel()
            begin()

    timer = node.create_timer(_LOOK_S, look, clock=Clock(clock_type=ClockType.STEADY_TIME))


class BareUav:
    """Answers like a UAV: four messages when odometry, near objects and neighbours are in."""

    def __init__(self, node: Node, scenario: Scenario, uav_id: int, edges: Edges) -> None:
        self.endpoints = Endpoints(node, edges.options.lockstep)
        self.ticks = 0
        self.pace = Pace(scenario.dt_ns)
        self._node = node
        self._scenario = scenario
        self._lockstep = edges.options.lockstep
        self._period_ns = scenario.dt_ns
        self._near_ns = scenario.dt_ns * scenario.near_every
        self._own_ns = self._seen_ns = self._done_ns = -1
        self._listen(uav_id, edges)
        self._sends = self._senders(uav_id, edges)
        self._ticker = None
        if not self._lockstep:
            self._ticker = Ticker(node, self._period_ns, self._on_timer)
        when_ready(node, self.endpoints, None, lambda: None)

    def _listen(self, uav_id: int, edges: Edges) -> None:
        senders = edges.senders(uav_id)
        heard = [topics.formation_state(i) for i in senders.states]
        heard += [topics.leader_estimate(i) for i in senders.estimators]
        self._heard_ns = [-1] * len(heard)
        self.endpoints.listen(topics.odom(uav_id), self._on_odom)
        self.endpoints.listen(topics.near(uav_id), self._on_near)
        for index, topic in enumerate(heard):
            self.endpoints.listen(topic, self._hearer(index))

    def _senders(self, uav_id: int, edges: Edges) -> tuple[Send, ...]:
        body, zeros = f"uav{uav_id}/base_link", np.zeros(13)
        state = OdometryTemplate(_FRAME, body).encode(0, zeros)
        estimate = OdometryTemplate(_FRAME, _FRAME).encode(0, zeros)
        velocity = VelocityTemplate(_FRAME).encode(0, zeros[:6])
        wrench = WrenchTemplate(body).encode(0, zeros[:6])
        ends, readers = self.endpoints, edges.options.recorders
        self._status_every = status_every(self._scenario)
        self._send_status = sender(ends, topics.DIAGNOSTICS, readers, _status(f"uav{uav_id}"))
        # The order of the Outbox: the wrench first.
        return (
            sender(ends, topics.wrench_setpoint(uav_id), 1 + readers, wrench),
            sender(ends, topics.formation_state(uav_id), edges.state_readers(uav_id), state),
            sender(ends, topics.leader_estimate(uav_id), edges.estimate_readers(uav_id), estimate),
            sender(ends, topics.velocity_setpoint(uav_id), readers, velocity),
        )

    def _hearer(self, index: int) -> Callable[[bytes], None]:
        def on_message(data: bytes) -> None:
            self._heard_ns[index] = peek_stamp(data)
            self._advance()

        return on_message

    def _on_odom(self, data: bytes) -> None:
        first = self._own_ns < 0
        self._own_ns = peek_stamp(data)
        if first and self._ticker is not None:
            self._ticker.align(self._own_ns)
        self._advance()

    def _on_near(self, data: bytes) -> None:
        self._seen_ns = peek_stamp(data)
        self._advance()

    def _advance(self) -> None:
        now_ns = self._own_ns
        if not self._lockstep or now_ns <= self._done_ns:
            return
        if self._seen_ns != now_ns - now_ns % self._near_ns:
            return
        before_ns = now_ns - self._period_ns
        if now_ns == 0 or all(stamp_ns >= before_ns for stamp_ns in self._heard_ns):
            self._answer(now_ns)

    def _on_timer(self) -> None:
        self.pace.tick(int(self._node.get_clock().now().nanoseconds))
        if self._own_ns < 0:
            self.pace.missed = 0
        else:
            self._answer(self._own_ns)

    def _answer(self, stamp_ns: int) -> None:
        self._done_ns = stamp_ns
        self.ticks += 1
        for send in self._sends:
            send(stamp_ns)
        if self.ticks % self._status_every == 0:
            self._send_status(stamp_ns)


class BareSim:
    """Ticks like the sim: by the barrier of all wrenches, or by a timer."""

    def __init__(
        self, node: Node, scenario: Scenario, edges: Edges, go: Path, on_end: Callable[[], None]
    ) -> None:
        self.endpoints = Endpoints(node, edges.options.lockstep)
        self.ticks = 0
        self.pace = Pace(scenario.dt_ns)
        self.latency = Latency()
        self.began_ns = self.ended_ns = 0
        self._node = node
        self._scenario = scenario
        self._lockstep = edges.options.lockstep
        self._on_end = on_end
        self._answers = 0
        self._now_ns = -1
        readers = edges.options.recorders
        near = np.ones((_NEAR_OBJECTS, 7))
        self._odom = self._senders(
            topics.odom,
            readers,
            lambda i: OdometryTemplate(_FRAME, f"uav{i}/base_link").encode(0, np.zeros(13)),
        )
        self._near = self._senders(topics.near, readers, lambda i: encode_near(0, _FRAME, near))
        clock = ClockTemplate().encode(0)
        self._clock = sender(self.endpoints, topics.CLOCK, readers, clock)
        self._send_status = sender(self.endpoints, topics.DIAGNOSTICS, readers, _status("sim"))
        self._send_markers = self.endpoints.publisher(topics.MARKERS, readers)
        self._markers = Scene(scenario, World(scenario)).markers(0)
        for i in scenario.uav_ids:
            self.endpoints.listen(topics.wrench_setpoint(i), self._on_wrench)
        when_ready(node, self.endpoints, go, self._begin)

    def _senders(
        self, topic: Callable[[int], Topic], readers: int, message: Callable[[int], bytes]
    ) -> list[Send]:
        return [
            sender(self.endpoints, topic(i), 1 + readers, message(i))
            for i in self._scenario.uav_ids
        ]

    def _begin(self) -> None:
        self.began_ns = self._clock_ns()
        if self._lockstep:
            self._publish(0)
        else:
            self._node.create_timer(self._scenario.dt_ns * 1e-9, self._on_timer)

    def _clock_ns(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def _on_timer(self) -> None:
        now_ns = self._clock_ns()
        self.pace.tick(now_ns)
        if now_ns - self.began_ns > self._scenario.duration_s * 1e9:
            self._end()
        else:
            self.ticks += 1
            self._publish(now_ns)

    def _publish(self, stamp_ns: int) -> None:
        self._now_ns = stamp_ns
        number = self.ticks
        for send in self._odom:
            send(stamp_ns)
        if number % self._scenario.near_every == 0:
            for send in self._near:
                send(stamp_ns)
        self._clock(stamp_ns)
        if number % status_every(self._scenario) == 0:
            self._send_markers(self._markers)
            self._send_status(stamp_ns)

    def _on_wrench(self, data: bytes) -> None:
        stamp_ns = peek_stamp(data)
        if not self._lockstep:
            self.latency.add((self._clock_ns() - stamp_ns) * 1e-9)
            return
        self._answers += stamp_ns == self._now_ns
        if self._answers < len(self._odom):
            return
        self._answers = 0
        self.ticks += 1
        if self.ticks < self._scenario.ticks:
            self._publish(self.ticks * self._scenario.dt_ns)
        else:
            self._end()

    def _end(self) -> None:
        self.ended_ns = self._clock_ns()
        self._on_end()


class BareRecorder:
    """Hears what the recorder hears, and drops it."""

    def __init__(self, node: Node, scenario: Scenario, lockstep: bool) -> None:
        self.endpoints = Endpoints(node, lockstep)
        self.received = 0
        for topic in topics.recorded(scenario.uav_ids):
            profile = qos.recorder_profile(topic, lockstep=lockstep)
            kind = topics.message_class(topic)
            node.create_subscription(kind, topic.name, self._on_message, profile, raw=True)
        when_ready(node, self.endpoints, None, lambda: None)

    def _on_message(self, _data: bytes) -> None:
        self.received += 1


def main(argv: Sequence[str] | None = None) -> int:
    """One process of the reference fleet; its last line is what it counted, as JSON."""
    parser = Arguments("pingpong", "A fleet without a mind")
    parser.add_argument("--role", choices=ROLES, required=True)
    parser.add_argument("--uav", type=int, default=0)
    parser.add_argument("--go", type=Path, help="the sim begins when this file exists")
    return run(parser, argv, _serve)


def _serve(arguments: argparse.Namespace, argv: list[str]) -> int:
    lifetime, scenario = Lifetime(), load_scenario(arguments.scenario)
    options = flight_options(arguments)
    edges = Edges(scenario, options)
    name = f"{arguments.role}{arguments.uav or ''}"
    if options.lockstep and arguments.role != "recorder":  # as the processes it stands beside
        environment.prefer_throughput()
    with ros_node(name, "", argv) as node:
        if arguments.role == "uav":
            uav = BareUav(node, scenario, arguments.uav, edges)
            lifetime.serve(node, uav.endpoints)
            counted = {"ticks": float(uav.ticks), "missed": float(uav.pace.missed)}
        elif arguments.role == "sim":
            sim = BareSim(node, scenario, edges, arguments.go, lifetime.end)
            lifetime.serve(node, sim.endpoints)
            counted = _sim_counts(sim)
        else:
            recorder = BareRecorder(node, scenario, options.lockstep)
            lifetime.serve(node, recorder.endpoints)
            counted = {"received": float(recorder.received)}
    print(json.dumps(counted), flush=True)
    return 0


def _sim_counts(sim: BareSim) -> dict[str, float]:
    return {
        "ticks": float(sim.ticks),
        "missed": float(sim.pace.missed),
        "seconds": (sim.ended_ns - sim.began_ns) * 1e-9,
        "p50_ms": 1e3 * sim.latency.percentile_s(50),
        "p99_ms": 1e3 * sim.latency.percentile_s(99),
    }


if __name__ == "__main__":
    raise SystemExit(main())
