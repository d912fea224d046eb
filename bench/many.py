"""A fleet of twenty UAVs, recorded: lost of how many, CPU of the recorder, megabytes a minute.

`ptnsbc fleet` as a user flies it: a process per UAV, all topics. How losses are counted: `bench.lost`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from bench.launch import BenchError
from bench.lost import Kept, in_lockstep, in_real_time
from bench.scenarios import grid
from bench.session import Plan, own_domain, say
from bench.table import Row, Target
from bench.usage import Sampler
from ptnsbc_io.bag import read_bag
from ptnsbc_nodes.comm.endpoints import PublishCounters, sent_in
from ptnsbc_nodes.comm.topics import RECORDER
from ptnsbc_nodes.fleet.fleet import FleetOptions, FleetResult, run_fleet

_UAVS = 20
_PATIENCE_S = 600.0  # the machine may be busy before what is measured begins


class Load(NamedTuple):
    """How the fleet flies."""

    name: str
    control_hz: int
    lockstep: bool


_LOADS = (Load("50 Hz in real time", 50, False), Load("100 Hz in lock-step", 100, True))


class Recorded(NamedTuple):
    """What the recorder made of a flight."""

    topics: tuple[Kept, ...]
    cores: float
    mb_per_min: float  # of flight
    steps_per_s: float  # by wall time, of each UAV


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    rows = []
    for load in _LOADS:
        say(f"many: {_UAVS} UAVs, {load.name}")
        found = _fly(load, plan.of(20.0, 3.0))
        sent = sum(topic.sent for topic in found.topics)
        lost = sum(max(topic.sent - topic.recorded, 0) for topic in found.topics)
        what = f"recorder, {_UAVS} UAVs, {load.name}"
        rows += [
            Row(f"{what}: lost of {sent} messages", [float(lost)], "messages", target=Target(0.0)),
            Row(f"{what}: CPU", [found.cores], "cores"),
            Row(f"{what}: bag", [found.mb_per_min], "MB/min"),
            Row(f"{what}: the flight", [found.steps_per_s], "steps/s"),
        ]
    return rows


def _fly(load: Load, seconds: float) -> Recorded:
    scenario = grid(_UAVS, load.control_hz, seconds)
    with tempfile.TemporaryDirectory(prefix="bench-") as name, own_domain(), Sampler() as sampler:
        folder = Path(name)

        lines: list[str] = []

        def progress(line: str) -> None:
            lines.append(line)
            if line.endswith("started"):
                sampler.begin()

        options = FleetOptions(
            scenario,
            lockstep=load.lockstep,
            bag=folder / "bag",
            log_dir=folder / "logs",
            ready_timeout_s=_PATIENCE_S,
        )
        flown = run_fleet(options, progress)
        if flown.died or flown.interrupted:
            raise BenchError("\n".join([f"fleet of {_UAVS}:", *lines]))
        count = in_lockstep if load.lockstep else in_real_time
        kept = tuple(count(read_bag(folder / "bag"), _told(flown)))
        size = sum(file.stat().st_size for file in (folder / "bag").iterdir())
    for topic in kept:
        if topic.sent != topic.recorded:
            say(f"many: {topic.name}: {topic.recorded} of {topic.sent}")
    steps = sum(topic.sent for topic in kept if topic.name.endswith("/setpoint/wrench"))
    return Recorded(
        kept,
        sampler.usage()[RECORDER].cores,
        size / 1e6 / (seconds / 60.0),
        steps / _UAVS / flown.flight_s,
    )


def _told(flown: FleetResult) -> dict[str, PublishCounters]:
    """What each process has sent."""
    found = {}
    for process in flown.processes:
        if process.name != RECORDER:
            sent = sent_in(process.log.read_text(errors="replace").splitlines())
            if sent is None:
                raise BenchError(f"{process.log}: does not say what was sent")
            found[process.name] = sent
    return found
