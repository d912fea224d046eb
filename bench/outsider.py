"""An outsider in the domain of a fleet that sends every forged message at 1 kHz: is it named, and what does it cost?

`python -m bench.outsider [--duration 25] [--times 2] [--hz 1000]`. The five UAVs of the paper fly calmly and among
forged messages, in turns, in real time, with `security: signed` and without obstacles: which way a UAV goes around one
is decided by milliseconds. The outsider joins when the flight has begun, and sends the messages of `forgeries` and the
states that it hears, moved by 0.5 m, in turns. Exit code 1 when a process died, no diagnostics named the outsider, a
forged topic was not reported, or the largest error after the deadline grew by 5 mm or more.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest.mock import patch

import numpy as np

from bench.scenarios import paper
from bench.session import Machine, print_progress, take_turns
from ptnsbc_io import wire
from ptnsbc_io.bag import read_bag
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.comm.seal import KEY_FILE, new_key
from ptnsbc_nodes.comm.topics import Topic
from ptnsbc_nodes.fleet.fleet import FleetOptions, run_fleet
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_tools.reading.bag_reader import read_recording

if TYPE_CHECKING:
    from ptnsbc_nodes.comm.endpoints import Endpoints

_NAME = "outsider"
_GROWTH_M = 5e-3
_JOINS_S = 2.0  # its publishers are discovered by then
_MOVED_M = 0.5
_NAMED = re.compile(r"second publisher of (/\S+): [^;]*/" + _NAME)


class Forgery(NamedTuple):
    """A message that no process of the fleet would send."""

    topic: Topic
    data: bytes


def forgeries(scenario: Scenario, now_ns: int) -> Iterator[Forgery]:
    """Every forged message, with stamps of now where a stamp could give it away."""
    header = wire.HeaderTemplate
    soon_ns = now_ns + 200_000_000
    for leg in ("hold", "form", "land", "dance", "x" * 5000):
        yield Forgery(topics.EPOCH, header(leg).encode(soon_ns))
    for order in ("kill all", "land all", "apart", "nonsense"):
        yield Forgery(topics.EMERGENCY, header(order).encode(0))
    for name in ("uav2", "sim", "recorder", "uav" + 5000 * "9"):
        yield Forgery(topics.LOST, header(name).encode(0))
    waits = {"ready": "false", "waiting_for": "uav2", "waited_s": "100"}
    for values in (waits, {**waits, "waited_s": "1e999"}):
        data = diagnostics(now_ns, "sim: world", DiagnosticLevel.ERROR, "forged", values)
        yield Forgery(topics.READY, data)
        yield Forgery(topics.DIAGNOSTICS, data)
    for uav in scenario.uav_ids:
        yield from _of_uav(uav, now_ns)


def _states(uav: int) -> tuple[tuple[Topic, str], ...]:
    """Topics with the state of a UAV, and their child frames."""
    body = f"uav{uav}/base_link"
    return (
        (topics.odom(uav), body),
        (topics.formation_state(uav), body),
        (topics.leader_estimate(uav), "map"),
    )


def _of_uav(uav: int, now_ns: int) -> Iterator[Forgery]:
    still = np.zeros(13)
    still[6] = 1.0
    odd = [still]
    for value in (np.nan, 1e308):
        odd.append(still.copy())
        odd[-1][0] = value
    for topic, frame in _states(uav):
        template = wire.OdometryTemplate("map", frame)
        for values in odd:
            yield Forgery(topic, template.encode(now_ns, values))
        yield Forgery(topic, template.encode(now_ns + 10**12, still))
        yield Forgery(topic, b"\0\1\0\0")
    cloud = wire.encode_near(now_ns, "map", np.ones((1, 7)))
    yield Forgery(topics.near(uav), cloud)
    yield Forgery(topics.near(uav), cloud.replace(b"radius\0", b"raddus\0"))
    for value in (np.nan, 1e308, 5.0):
        wrench = wire.WrenchTemplate(f"uav{uav}/base_link").encode(now_ns, np.full(6, value))
        yield Forgery(topics.wrench_setpoint(uav), wrench)


class Eavesdropper:
    """Hears the states of all UAVs, and moves them."""

    def __init__(self, ends: Endpoints, scenario: Scenario) -> None:
        self._heard: dict[Topic, tuple[bytes, wire.OdometryTemplate]] = {}
        for uav in scenario.uav_ids:
            for topic, frame in _states(uav):
                ends.listen(topic, bytes, self._keep(topic, wire.OdometryTemplate("map", frame)))

    def _keep(self, topic: Topic, template: wire.OdometryTemplate) -> Callable[[bytes], None]:
        return lambda data: self._heard.__setitem__(topic, (data, template))

    def moved(self, now_ns: int) -> list[Forgery]:
        """The newest states, `_MOVED_M` beside where they are, with stamps of now."""
        forged = []
        for topic, (data, template) in self._heard.items():
            values = wire.decode_odometry(data).values.copy()
            values[0] += _MOVED_M
            forged.append(Forgery(topic, template.encode(now_ns, values)))
        return forged

    def mixed(self, scenario: Scenario) -> Iterator[Forgery]:
        """Every forged message that there is a topic for, and a state that is moved after each."""
        moved: list[Forgery] = []
        for one in list(forgeries(scenario, time.time_ns())):
            yield one
            moved = moved or self.moved(time.time_ns())
            if moved:
                yield moved.pop()


def attacked(scenario: Scenario) -> set[Topic]:
    """The topics of forged messages."""
    return {one.topic for one in forgeries(scenario, 0)}


def attack(scenario: Scenario, hz: float) -> None:
    """Join the domain of the environment, wait for the flight, and send until the end of the process."""
    from ptnsbc_nodes.runtime import environment

    environment.prepare()
    import rclpy

    from ptnsbc_nodes.comm.endpoints import Endpoints
    from ptnsbc_nodes.runtime.executor import BoundedSpin, make_executor

    rclpy.init()
    node = rclpy.create_node(_NAME)
    executor = make_executor(rclpy.get_default_context())
    executor.add_node(node)
    spin = BoundedSpin(executor)
    ends, begun = Endpoints(node, lockstep=False), list[bytes]()
    ends.listen(topics.EPOCH, bytes, begun.append)
    eavesdropper = Eavesdropper(ends, scenario)
    while not begun:
        spin.serve(0.1)
    send = {topic: ends.publisher(topic, 0) for topic in attacked(scenario)}
    spin.serve(_JOINS_S)  # for discovery: there is no match to wait for on topics without a reader
    sent, began = 0, time.monotonic()
    while True:
        for topic, data in eavesdropper.mixed(scenario):
            send[topic](data)
            sent += 1
            # The rate is what is asked of it: there is nothing else to wait for.
            spin.serve(max(began + sent / hz - time.monotonic(), 0.0))
        rate = sent / (time.monotonic() - began)
        print(json.dumps({"sent": sent, "hz": round(rate)}), flush=True)


@contextmanager
def _beside(settings: Mapping[str, str], scenario_file: Path, hz: float) -> Iterator[None]:
    """An outsider beside a fleet: with its domain, and without its key."""
    outside = {name: value for name, value in settings.items() if name != KEY_FILE}
    command = [sys.executable, "-m", "bench.outsider", "--attack", str(scenario_file)]
    log = scenario_file.with_name(f"{_NAME}.log")
    with log.open("w", encoding="utf-8") as file:
        process = subprocess.Popen([*command, "--hz", str(hz)], env=outside, stdout=file)
        try:
            yield
        finally:
            process.kill()
            process.wait()


class Flown(NamedTuple):
    """Errors, exits and diagnostics of one flight."""

    error_m: float  # the largest of all UAVs after the deadline
    died: tuple[str, ...]
    exit_code: int
    missed_ticks: int
    sent: Mapping[str, int]  # by the outsider
    named: tuple[str, ...]  # messages of diagnostics that name it, without their repetitions
    refused: Mapping[str, int]  # by topic, of all processes


def fly(scenario: Scenario, hz: float) -> Flown:
    """One flight; `hz` is 0 for a calm one."""
    with tempfile.TemporaryDirectory(prefix="outsider-") as name:
        folder = Path(name)
        new_key(folder / "fleet.key")
        with patch.dict(os.environ, {KEY_FILE: str(folder / "fleet.key")}):
            beside = None if not hz else lambda settings, file: _beside(settings, file, hz)
            options = FleetOptions(
                scenario, bag=folder / "bag", log_dir=folder / "logs", beside=beside
            )
            flown = run_fleet(options)
        log = folder / "logs" / f"{_NAME}.log"
        lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
        recording = read_recording(folder / "bag")
        named, refused = _reports(folder / "bag")
    verdict = verdict_on(recording)
    return Flown(
        max(one.max_error_after_all_m or 0.0 for one in verdict.uavs),
        tuple(flown.died),
        flown.exit_code,
        verdict.missed_ticks,
        json.loads(lines[-1]) if lines else {},
        named,
        refused,
    )


def _reports(bag: Path) -> tuple[tuple[str, ...], dict[str, int]]:
    """The lines about the outsider in the diagnostics of a bag."""
    named: set[str] = set()
    newest: dict[tuple[str, str], int] = {}
    for message in read_bag(bag).messages([topics.DIAGNOSTICS.name]):
        for status in wire.decode_diagnostics(message.data).statuses:
            named.update(_NAMED.findall(status.message))
            for word in status.values.get("refused", "").split():
                topic, _, count = word.rpartition("=")
                newest[status.name, topic] = int(count)
    total: dict[str, int] = {}
    for (_, topic), refused in newest.items():
        total[topic] = total.get(topic, 0) + refused
    return tuple(sorted(named)), total


def heard(scenario: Scenario) -> set[str]:
    """The names of the attacked topics that a UAV or the sim takes messages of."""
    edges = CommunicationGraph(scenario, FlightOptions())
    found = {topics.EPOCH, topics.LOST}
    for uav in scenario.uav_ids:
        found |= {topics.odom(uav), topics.near(uav), topics.wrench_setpoint(uav)}
        found |= {topics.formation_state(i) for i in edges.senders(uav).states}
        found |= {topics.leader_estimate(i) for i in edges.senders(uav).estimators}
    return {one.name for one in found & attacked(scenario)}


def main(arguments: Sequence[str] | None = None) -> int:
    """See above."""
    parser = argparse.ArgumentParser(prog="python -m bench.outsider", description=__doc__)
    parser.add_argument("--duration", type=float, default=25.0, metavar="S")
    parser.add_argument("--times", type=int, default=2, metavar="N")
    parser.add_argument("--hz", type=float, default=1000.0)
    parser.add_argument("--attack", metavar="SCENARIO", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.attack is not None:
        attack(load_scenario(options.attack), options.hz)
    scenario = paper(options.duration).with_({"security": "signed", "world.obstacles": []})
    machine = Machine()
    runs = {"calm": lambda: fly(scenario, 0.0), "attacked": lambda: fly(scenario, options.hz)}
    found = take_turns(runs, options.times, _NAME)
    report = summary(scenario, found["calm"], found["attacked"])
    print(json.dumps({**report, "machine": machine.facts()}, indent=1))
    return int(bool(report["wrong"]))


def summary(scenario: Scenario, calm: Sequence[Flown], attacked: Sequence[Flown]) -> dict[str, Any]:
    """The figures of all flights, and what is wrong with them."""
    grown_m = max(one.error_m for one in attacked) - max(one.error_m for one in calm)
    wrong = [f"died: {name}" for one in (*calm, *attacked) for name in one.died]
    for one in attacked:
        wrong += [] if one.named else ["the outsider was not named"]
        wrong += [
            f"{topic}: nothing refused" for topic in sorted(heard(scenario) - set(one.refused))
        ]
    wrong += [f"the error grew by {1e3 * grown_m:.1f} mm"] if grown_m >= _GROWTH_M else []
    print_progress(f"error grew by {1e3 * grown_m:.2f} mm")
    return {
        "calm_error_mm": [round(1e3 * one.error_m, 2) for one in calm],
        "attacked_error_mm": [round(1e3 * one.error_m, 2) for one in attacked],
        "grown_mm": round(1e3 * grown_m, 2),
        "missed_ticks": {
            "calm": [one.missed_ticks for one in calm],
            "attacked": [one.missed_ticks for one in attacked],
        },
        "sent": [one.sent for one in attacked],
        "refused": [sum(one.refused.values()) for one in attacked],
        "named_topics": [list(one.named) for one in attacked],
        "wrong": wrong,
    }


if __name__ == "__main__":
    sys.exit(main())
