"""Recording what twenty UAVs say at every tick: lost of how many, CPU of the recorder, megabytes a minute.

As a module it is the source: one process that says what twenty would, at a pace, and counts it. Left out
are the slow topics: snapshots, diagnostics, markers.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rclpy.node import Node

from bench.launch import counts_of, wait_ready
from bench.pingpong import when_ready
from bench.scenarios import paper
from bench.session import Plan, own_domain, say
from bench.table import Row, Target
from bench.usage import look
from ptnsbc_nodes import environment, topics
from ptnsbc_nodes.children import Child, Command, end
from ptnsbc_nodes.endpoints import Endpoints
from ptnsbc_nodes.letters import Letters
from ptnsbc_nodes.process import Arguments, Lifetime, ros_node, run
from ptnsbc_nodes.topics import Topic
from ptnsbc_nodes.wire import ClockTemplate, RowTemplate, Stamped, encode_near
from ptnsbc_nodes.wire.cdr import write_stamp

_UAVS = 20
_VARIANTS = 50  # of each message, so that it compresses as a flight does
_SETTLE_S = 1.0
_NEAR_EVERY = 5
_TICK_NUMBERS = 21
_PATIENCE_S = 60.0


class Load(NamedTuple):
    """How the fleet speaks."""

    name: str
    hz: float
    lockstep: bool


_LOADS = (Load("50 Hz in real time", 50.0, False), Load("100 Hz in lock-step", 100.0, True))


class Kept(NamedTuple):
    """What the recorder made of it."""

    sent: int
    lost: int
    cores: float
    mb_per_min: float


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    rows = []
    for load in _LOADS:
        say(f"many: {_UAVS} UAVs, {load.name}")
        found = _record(load, plan.of(20.0, 2.0))
        what = f"recorder, {_UAVS} UAVs, {load.name}"
        lost = f"{what}: lost of {found.sent} messages"
        rows += [
            Row(lost, [float(found.lost)], "messages", target=Target(0.0)),
            Row(f"{what}: CPU", [found.cores], "cores"),
            Row(f"{what}: bag", [found.mb_per_min], "MB/min"),
        ]
    return rows


def _record(load: Load, seconds: float) -> Kept:
    mode = ("--lockstep",) if load.lockstep else ()
    with tempfile.TemporaryDirectory(prefix="bench-") as name, own_domain() as domain:
        folder = Path(name)
        scenario, go, bag = folder / "scenario.yaml", folder / "go", folder / "bag"
        scenario.write_text(paper(1.0).text, encoding="utf-8")
        settings = environment.for_children(domain, 2, folder)
        uavs = tuple(str(uav) for uav in range(1, _UAVS + 1))
        recorder = ("--bag", str(bag), "--uavs", *uavs, *mode)
        source = ("--scenario", str(scenario), "--hz", str(load.hz), "--seconds", str(seconds))
        crew = [
            Child(Command("recorder", "ptnsbc_nodes.recorder", recorder), settings, folder),
            Child(
                Command("source", "bench.many", (*source, "--go", str(go), *mode)), settings, folder
            ),
        ]
        try:
            wait_ready(crew)
            before_s, began = look(crew[0].pid).cpu_s, time.monotonic()
            go.touch()
            while crew[1].exit_code is None:
                time.sleep(0.05)
            time.sleep(_SETTLE_S)
            cores = (look(crew[0].pid).cpu_s - before_s) / (time.monotonic() - began)
        finally:
            end(crew)
        kept, sent = (counts_of(child) for child in crew)
        size = sum(file.stat().st_size for file in bag.iterdir())
    made = dict(kept["topics"])["/tf"]  # by the recorder itself, of odometry
    lost = int(sent["sent"]) - (int(kept["messages"]) - int(made))
    return Kept(int(sent["sent"]), lost, cores, size / 1e6 / (float(sent["seconds"]) / 60.0))


class Source:
    """Publishes for `seconds`: all topics of all UAVs, `hz` times a second, and /clock."""

    def __init__(
        self, node: Node, arguments: argparse.Namespace, on_end: Callable[[], None]
    ) -> None:
        self.sent = 0
        self.took_s = 0.0
        self._on_end = on_end
        self._period_s = 1.0 / arguments.hz
        self._seconds = arguments.seconds
        self.endpoints = Endpoints(node, arguments.lockstep)
        self._outlets = [
            (self.endpoints.publisher(topic, 1), variants, every, stamped)
            for topic, variants, every, stamped in _messages(realtime=not arguments.lockstep)
        ]
        when_ready(node, self.endpoints, arguments.go, self._run)

    def _run(self) -> None:
        began = due = time.monotonic()
        rounds = 0
        while due - began < self._seconds:
            stamp_ns = round(rounds * self._period_s * 1e9)
            for publish, variants, every, stamped in self._outlets:
                if rounds % every == 0:
                    message = variants[rounds % len(variants)]
                    if stamped:
                        write_stamp(message, stamp_ns)
                    publish(bytes(message))
                    self.sent += 1
            rounds += 1
            due += self._period_s
            time.sleep(max(due - time.monotonic(), 0.0))
        self.took_s = time.monotonic() - began
        # Reliable messages still on their way are not lost; a fleet waits for its recorder too.
        self.endpoints.flush(_PATIENCE_S)
        self._on_end()


def _messages(*, realtime: bool) -> Iterator[tuple[Topic, list[bytearray], int, bool]]:
    """Topic, variants of its message, of which rounds, and whether it carries a stamp."""
    rng = np.random.default_rng(1)
    for uav in range(1, _UAVS + 1):
        letters = Letters(uav)
        states = np.cumsum(rng.normal(size=(_VARIANTS, 13)), axis=0)
        odometry = [bytearray(letters.state(Stamped(0, values))) for values in states]
        near = [bytearray(encode_near(0, "map", rng.normal(size=(3, 7)))) for _ in states]
        estimates = [bytearray(letters.estimate(0, values)) for values in states]
        velocities = [bytearray(letters.velocity(0, values[:4])) for values in states]
        wrenches = [bytearray(letters.wrench(0, values[:6])) for values in states]
        yield topics.odom(uav), odometry, 1, True
        yield topics.near(uav), near, _NEAR_EVERY, True
        yield topics.formation_state(uav), odometry, 1, True
        yield topics.leader_estimate(uav), estimates, 1, True
        yield topics.velocity_setpoint(uav), velocities, 1, True
        yield topics.wrench_setpoint(uav), wrenches, 1, True
        if realtime:
            template = RowTemplate("number " * _TICK_NUMBERS, _TICK_NUMBERS)
            rows = rng.integers(0, 2**62, (_VARIANTS, _TICK_NUMBERS)).tolist()
            ticks = [bytearray(template.integers(row)) for row in rows]
            yield topics.tick(uav), ticks, 1, False
    yield topics.CLOCK, [bytearray(ClockTemplate().encode(0))], 1, True


def main(argv: Sequence[str] | None = None) -> int:
    """The source; its last line is what it sent, as JSON."""
    parser = Arguments("source", "Messages of twenty UAVs")
    parser.add_argument("--hz", type=float, required=True)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--go", type=Path, required=True)
    return run(parser, argv, _serve)


def _serve(arguments: argparse.Namespace, argv: list[str]) -> int:
    lifetime = Lifetime()
    with ros_node("source", "", argv) as node:
        source = Source(node, arguments, lifetime.end)
        lifetime.serve(node, source.endpoints)
    print(json.dumps({"sent": source.sent, "seconds": source.took_s}), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
