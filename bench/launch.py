"""Flights of real processes: the project's fleet, and the reference with the same processes."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

from bench.observer import Observer
from bench.pingpong.endpoints import READY
from bench.session import own_domain
from bench.usage import Sampler, Usage
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.fleet.child_process import ChildProcess, ProcessCommand, end
from ptnsbc_nodes.fleet.fleet import FleetOptions, FleetResult, run_fleet
from ptnsbc_nodes.runtime import environment
from ptnsbc_sim.scenario import Scenario

_POLL_S = 0.05
_MODULE = "bench.pingpong"


class BenchError(PtnsbcError):
    """A run from which no figure can be read."""


@dataclass(frozen=True)
class Flown:
    """Figures of one flight; a figure that its mode does not have is 0."""

    steps_per_s: float
    missed_percent: float  # of the ticks of all UAVs
    latency_p50_ms: float  # odometry sent to wrench received
    latency_p99_ms: float
    lost_percent: float  # of the messages that a recorder should have had
    usage: Mapping[str, Usage]


def fleet(scenario: Scenario, *, lockstep: bool, bag: bool, processes: int | None = None) -> Flown:
    """Fly a fleet as `ptnsbc fleet` does, its UAVs in as many `processes`: one for each by default."""
    rate = 0.0
    with (
        tempfile.TemporaryDirectory(prefix="bench-") as folder,
        own_domain() as domain,
        # Not in lock-step: there the steps alone are measured, and the reference has no observer either.
        nullcontext() if lockstep else Observer(domain) as observer,
        Sampler() as sampler,
    ):

        def progress(line: str) -> None:
            nonlocal rate
            if line.endswith("started"):
                sampler.begin()
            if line.endswith("steps/s"):
                rate = float(line.split()[-2])  # the last line is the average of the flight

        options = FleetOptions(
            scenario,
            lockstep=lockstep,
            bag=Path(folder) / "bag" if bag else None,
            log_dir=Path(folder) / "logs",
            processes=processes,
        )
        result = run_fleet(options, progress)
        values_by_node = observer.newest() if observer else {}
    if result.died or result.interrupted:
        raise BenchError(f"fleet of {len(scenario.uav_ids)}: interrupted or lost {result.died}")
    uavs = [values for name, values in values_by_node.items() if name.startswith("uav")]
    sim = values_by_node["sim"] if observer else {}
    missed, ticks = (sum(int(uav[key]) for uav in uavs) for key in ("missed_ticks", "ticks"))
    return Flown(
        rate,
        _percent(missed, ticks),
        float(sim.get("latency_p50_ms", 0.0)),
        float(sim.get("latency_p99_ms", 0.0)),
        _lost(result),
        sampler.usage(),
    )


def bare(scenario: Scenario, *, lockstep: bool, bag: bool, typed: bool = False) -> Flown:
    """The same processes without laws.

    Args:
        scenario: the UAVs, their communication graph and the duration.
        lockstep: as fast as it goes, or by the wall clock.
        bag: with one more process that subscribes to everything and drops it.
        typed: messages are objects, as in any rclpy program; otherwise bytes that no process decodes.
    """
    roles = [("recorder", 0)] if bag else []
    roles += [("sim", 0), *(("uav", i) for i in scenario.uav_ids)]
    chosen = (("--lockstep", lockstep), ("--recorded", bag), ("--typed", typed))
    flags = [flag for flag, on in chosen if on]
    with (
        tempfile.TemporaryDirectory(prefix="bench-") as name,
        own_domain() as domain,
        Sampler() as sampler,
    ):
        folder = Path(name)
        file, go = folder / "scenario.yaml", folder / "go"
        file.write_text(scenario.text, encoding="utf-8")
        settings = environment.for_children(domain, len(roles) + 1, folder)
        processes: list[ChildProcess] = []
        try:
            for role, uav in roles:
                words = ("--scenario", str(file), "--role", role, "--uav", str(uav))
                command = ProcessCommand(
                    f"{role}{uav}",
                    _MODULE,
                    (*words, "--go", str(go), *flags),
                    (uav,) if uav else (),
                )
                processes.append(ChildProcess(command, settings, folder))
            wait_ready(processes)
            sampler.begin()
            go.touch()
            _wait_landed(processes, scenario.duration_s)
        finally:
            end(processes)
        counts = {child.name: counts_of(child) for child in processes}
    sim = counts["sim0"]
    uavs = [one for process, one in counts.items() if process.startswith("uav")]
    return Flown(
        sim["ticks"] / sim["seconds"],
        _percent(sum(each["missed"] for each in uavs), sum(each["ticks"] for each in uavs)),
        sim["p50_ms"],
        sim["p99_ms"],
        0.0,
        sampler.usage(),
    )


def wait_ready(processes: list[ChildProcess]) -> None:
    deadline = time.monotonic() + 60.0 + 5.0 * len(processes)
    waiting = list(processes)
    while waiting:
        for child in waiting:
            if child.exit_code is not None:
                raise BenchError(f"bare fleet: {child.exit_summary()}")
        if time.monotonic() > deadline:
            raise BenchError(f"bare fleet: not ready: {', '.join(c.name for c in waiting)}")
        time.sleep(_POLL_S)  # a log file gives no notice
        waiting = [child for child in waiting if READY not in child.log_lines()]


def _wait_landed(processes: list[ChildProcess], duration_s: float) -> None:
    (sim,) = (child for child in processes if child.name == "sim0")
    if sim.wait(60.0 + 10.0 * duration_s) is None:
        raise BenchError(f"bare fleet: the sim does not end\n{sim.tail()}")


def counts_of(child: ChildProcess) -> dict[str, float]:
    try:
        found: dict[str, float] = json.loads("".join(child.log_lines()[-1:]))
    except ValueError:
        raise BenchError(f"bare fleet: {child.exit_summary()}") from None
    return found


def _percent(part: float, rest: float) -> float:
    return 100.0 * part / max(part + rest, 1.0)


def _lost(result: FleetResult) -> float:
    """Share of the ticks that one UAV's topics lack in the bag, on average."""
    counts = result.recorded.get("topics", {})
    ticks = counts.get("/clock", 0)
    if not ticks:
        return 0.0
    kept = [count for name, count in counts.items() if name.endswith("/odom")]
    return max(0.0, 100.0 * (1.0 - mean(kept) / ticks))
