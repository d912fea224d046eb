"""The recorder: CPU time per message, messages per second, and losses.

Run as a module it is the source: the topics of five UAVs, paced or as fast as one process can publish.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rclpy.node import Node

from bench.launch import counts_of, wait_ready
from bench.pingpong.endpoints import RawEndpoints, Send, when_ready
from bench.scenarios import paper
from bench.session import Plan, own_domain, take_turns
from bench.table import Row
from bench.usage import look
from ptnsbc_io.wire import OdometryTemplate, VelocityTemplate, WrenchTemplate
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.fleet.child_process import ChildProcess, ProcessCommand, end
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.process import Arguments, ProcessLifetime, ros_node, run

_UAVS = ("1", "2", "3", "4", "5")
_HZ = 100.0
_SETTLE_S = 0.5
_PATIENCE_S = 60.0
_FLOOD = 0.0


class Received(NamedTuple):
    """One run of a source and a listener."""

    cpu_us: float  # of the listener per message received
    rate: float  # messages received per second
    lost_percent: float


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    seconds = plan.of(6.0, 2.0)
    found = take_turns(
        {
            "bare listener": lambda: _listen(_bare, _HZ, seconds),
            "recorder": lambda: _listen(_recorder, _HZ, seconds),
            "bare listener, flooded": lambda: _listen(_bare, _FLOOD, seconds),
            "recorder, flooded": lambda: _listen(_recorder, _FLOOD, seconds),
        },
        plan.of(3, 1),
        "recorder",
    )

    def row(figure: str, unit: str, ends: str, value: Callable[[Received], float]) -> Row:
        own, other = found[f"recorder{ends}"], found[f"bare listener{ends}"]
        name = "listener that drops"
        return Row(figure, [value(one) for one in own], unit, name, [value(one) for one in other])

    return [
        row("recorder, CPU per message", "µs", "", lambda one: one.cpu_us),
        row("recorder, 5 UAVs at 100 Hz: lost", "%", "", lambda one: one.lost_percent),
        row("recorder, one source flat out", "messages/s", ", flooded", lambda one: one.rate),
        row("recorder, flat out: lost", "%", ", flooded", lambda one: one.lost_percent),
    ]


def _recorder(folder: Path, _scenario: Path) -> ProcessCommand:
    bag = tempfile.mkdtemp(dir=folder)
    arguments = ("--bag", f"{bag}/bag", "--uavs", *_UAVS)
    return ProcessCommand("listener", "ptnsbc_nodes.recording.main", arguments)


def _bare(_folder: Path, scenario: Path) -> ProcessCommand:
    arguments = ("--scenario", str(scenario), "--role", "recorder")
    return ProcessCommand("listener", "bench.pingpong", arguments)


def _listen(
    listener: Callable[[Path, Path], ProcessCommand], hz: float, seconds: float
) -> Received:
    with tempfile.TemporaryDirectory(prefix="bench-") as name, own_domain() as domain:
        folder = Path(name)
        scenario, go = folder / "scenario.yaml", folder / "go"
        scenario.write_text(paper(1.0).text, encoding="utf-8")
        settings = environment.for_children(domain, 2, folder)
        words = ("--scenario", str(scenario), "--hz", str(hz), "--seconds", str(seconds))
        source = ProcessCommand("source", "bench.recorder", (*words, "--go", str(go)))
        processes = [
            ChildProcess(command, settings, folder)
            for command in (listener(folder, scenario), source)
        ]
        try:
            wait_ready(processes)
            before_s = look(processes[0].pid).cpu_s
            go.touch()
            processes[1].wait(_PATIENCE_S + seconds)
            # Queued messages cost the listener time too, and it does not report when it has received all of them.
            time.sleep(_SETTLE_S)
            cpu_s = look(processes[0].pid).cpu_s - before_s
        finally:
            end(processes)
        received, sent = (counts_of(child) for child in processes)
    got = float(received.get("received", received.get("messages", 0)))
    lost = 100.0 * (1.0 - got / sent["sent"])
    return Received(1e6 * cpu_s / max(got, 1.0), got / sent["seconds"], lost)


class Source:
    """Publishes for `seconds`: rounds of five messages per UAV, `hz` a second, or without a pause."""

    def __init__(
        self, node: Node, arguments: argparse.Namespace, on_end: Callable[[], None]
    ) -> None:
        self.sent = 0
        self.took_s = 0.0
        self._on_end = on_end
        self._period_s = 1.0 / arguments.hz if arguments.hz else 0.0
        self._seconds = arguments.seconds
        self.endpoints = RawEndpoints(node, lockstep=False)
        self._sends = [send for uav in _UAVS for send in self._of(int(uav))]
        when_ready(node, self.endpoints, arguments.go, self._run)

    def _of(self, uav: int) -> list[Send]:
        zeros = np.zeros(13)
        odometry = OdometryTemplate("map", f"uav{uav}/base_link").encode(0, zeros)
        return [
            self.endpoints.sender(topic, 1, message)
            for topic, message in (
                (topics.odom(uav), odometry),
                (topics.formation_state(uav), odometry),
                (topics.leader_estimate(uav), odometry),
                (topics.velocity_setpoint(uav), VelocityTemplate("map").encode(0, zeros[:6])),
                (topics.wrench_setpoint(uav), WrenchTemplate("map").encode(0, zeros[:6])),
            )
        ]

    def _run(self) -> None:
        began = time.monotonic()
        due = began
        while due - began < self._seconds:
            for send in self._sends:
                send(int(1e9 * (due - began)))
            self.sent += len(self._sends)
            now = time.monotonic()
            due = due + self._period_s if self._period_s else now
            time.sleep(max(due - now, 0.0))  # at the rate of a fleet, or without a pause
        self.took_s = time.monotonic() - began
        self._on_end()


def main(argv: Sequence[str] | None = None) -> int:
    """The source; its last line counts what it sent, as JSON."""
    parser = Arguments("source", "Messages to record")
    parser.add_argument("--hz", type=float, default=_FLOOD)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--go", type=Path, required=True)
    return run(parser, argv, _serve)


def _serve(arguments: argparse.Namespace, argv: list[str]) -> int:
    lifetime = ProcessLifetime()
    with ros_node("source", "", argv) as node:
        source = Source(node, arguments, lifetime.end)
        lifetime.serve(node, source.endpoints)
    print(json.dumps({"sent": source.sent, "seconds": source.took_s}), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
