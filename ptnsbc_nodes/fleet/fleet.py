"""A whole flight, or this computer's part of it: a process per UAV, the sim, the recorder."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ptnsbc_nodes.comm.endpoints import RECORDER
from ptnsbc_nodes.fleet.coordinator_node import Coordinator
from ptnsbc_nodes.fleet.process_list import FleetOptions, chosen, commands, names
from ptnsbc_nodes.fleet.supervisor import FleetError, Report, Supervisor
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.ros_domain import reserved_domain
from ptnsbc_nodes.runtime.signals import StopRequest
from ptnsbc_nodes.runtime.warmup import load_agent, load_world

__all__ = ["FleetError", "FleetOptions", "FleetResult", "ProcessReport", "chosen", "run_fleet"]

_DIED, _INTERRUPTED = 1, 130


@dataclass(frozen=True)
class ProcessReport:
    """How one process ended."""

    name: str
    pid: int
    exit_code: int | None  # minus the signal's number when a signal ended it
    log: Path


@dataclass(frozen=True)
class FleetResult:
    """A flight that has ended, whichever way."""

    processes: tuple[ProcessReport, ...]
    died: tuple[str, ...]  # processes that ended before their time
    lost: tuple[int, ...]  # ids of the UAVs among them
    interrupted: bool  # by SIGINT or SIGTERM
    bag: Path | None
    recorded: Mapping[str, Any]  # the recorder's own summary
    startup_s: float  # wall time
    flight_s: float  # wall time

    @property
    def exit_code(self) -> int:
        """0, or 1 when a process died, or 130 when interrupted."""
        return _DIED if self.died else _INTERRUPTED if self.interrupted else 0


def run_fleet(options: FleetOptions, progress: Report = lambda line: None) -> FleetResult:
    """Fly; `progress` gets a line now and then. FleetError when the fleet does not get ready.

    SIGINT and SIGTERM end the flight in order, the recorder last. Call it from the main thread: the
    processes end with the thread that started them.
    """
    if options.bag is not None and options.bag.exists() and not options.overwrite:
        raise FleetError(f"{options.bag} exists: choose another name or pass --overwrite")
    refuse_nonsense(options)
    log_dir = Path(options.log_dir or tempfile.mkdtemp(prefix="ptnsbc-")).resolve()
    log_dir.mkdir(parents=True, exist_ok=True)
    scenario_file = log_dir / "scenario.yaml"
    scenario_file.write_text(options.scenario.text, encoding="utf-8")
    _prepare_kernels(options, progress)
    crew = commands(options, scenario_file)
    with StopRequest() as stop, reserved_domain() as domain:
        settings = environment.for_children(domain, _most_processes(options, len(crew)), log_dir)
        progress(f"domain {domain}, logs in {log_dir}")
        with Coordinator(domain, _tower_name(options)) as tower:
            flight = Supervisor(options, tower, stop, progress)
            began = time.monotonic()
            try:
                flight.start(crew, settings, log_dir, began + options.patience_s)
                took_off = time.monotonic()
                flight.watch(options.scenario.duration_s)
                landed = time.monotonic()
            finally:
                flight.end()
    return FleetResult(
        processes=tuple(
            ProcessReport(child.name, child.pid, child.exit_code, child.log)
            for child in flight.children
        ),
        died=(*(child.name for child in flight.died), *flight.lost_elsewhere),
        lost=tuple(dict.fromkeys(_lost(flight))),
        interrupted=stop.came,
        bag=options.bag,
        recorded=_recorded(flight),
        startup_s=took_off - began,
        flight_s=landed - took_off,
    )


def _most_processes(options: FleetOptions, here: int) -> int:
    """Of the whole fleet on one host, with a launcher for each at most."""
    return 2 * len(names(options.scenario, options.backend)) if options.shared else here + 1


def _tower_name(options: FleetOptions) -> str:
    """Unlike those of the launchers on other computers."""
    return "fleet" if options.leads else f"fleet_{min(options.only)}"


def _lost(flight: Supervisor) -> Iterator[int]:
    for child in flight.died:
        if child.command.uav is not None:
            yield child.command.uav
    for name in flight.lost_elsewhere:
        yield int(name.removeprefix("uav"))


def _recorded(flight: Supervisor) -> Mapping[str, Any]:
    recorder = next((child for child in flight.children if child.name == RECORDER), None)
    summary = recorder.last_line() if recorder else ""
    try:
        found = json.loads(summary)
    except ValueError:  # it was killed before it could tell
        return {}
    return found if isinstance(found, dict) else {}


def refuse_nonsense(options: FleetOptions) -> None:
    """FleetError when the options do not go together."""
    if options.bag is not None and not options.leads:
        raise FleetError(
            f"--bag {options.bag}: the recorder is not among --only "
            f"{','.join(sorted(options.only))}: expected it there, or no --bag on this computer"
        )
    if options.shared and "ROS_DOMAIN_ID" not in os.environ:
        raise FleetError(
            "--only: the computers of a fleet find each other in one domain: expected --domain N, "
            "the same on all of them, or ROS_DOMAIN_ID"
        )
    if options.backend != "mavlink":
        return
    if options.lockstep:
        raise FleetError("real vehicles do not wait: expected no --lockstep with --backend mavlink")
    if not options.allow_arming:
        raise FleetError(
            "--backend mavlink arms and flies vehicles: expected --allow-arming; to look at a "
            "vehicle without arming it: ptnsbc bridge"
        )


def _prepare_kernels(options: FleetOptions, progress: Report) -> None:
    """Compile once, before a dozen processes would do it side by side."""
    progress("preparing the laws (compiled at first use, then read from the cache)")
    load_agent(options.scenario, options.scenario.leader_id)
    if options.backend == "sim":
        load_world(options.scenario)
