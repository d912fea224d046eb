"""A whole flight on one host: a process per UAV, the sim, the recorder; started, watched, ended."""

from __future__ import annotations

import json
import os
import signal
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes import environment
from ptnsbc_nodes.children import Child, Command, end
from ptnsbc_nodes.crew import SIM, FleetOptions, commands
from ptnsbc_nodes.domain import reserved_domain
from ptnsbc_nodes.endpoints import RECORDER
from ptnsbc_nodes.stop import StopRequest
from ptnsbc_nodes.tower import Tower
from ptnsbc_nodes.warmup import load_agent, load_world

__all__ = ["FleetError", "FleetOptions", "FleetResult", "ProcessReport", "run_fleet"]

Report = Callable[[str], None]

_LOOK_S = 0.05
_AFTER_START_S = 1.0  # the epoch is half a second after the call
_LANDING_CALL_S = 3.0
_LANDING_S = 240.0
_RECORDER_PATIENCE_S = 60.0  # what is still queued belongs into the bag
_DIED, _INTERRUPTED = 1, 130


class FleetError(PtnsbcError):
    """A fleet that could not take off."""


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
    _refuse_nonsense(options)
    log_dir = Path(options.log_dir or tempfile.mkdtemp(prefix="ptnsbc-")).resolve()
    log_dir.mkdir(parents=True, exist_ok=True)
    scenario_file = log_dir / "scenario.yaml"
    scenario_file.write_text(options.scenario.text, encoding="utf-8")
    _prepare_kernels(options, progress)
    crew = commands(options, scenario_file)
    with StopRequest() as stop, reserved_domain() as domain:
        settings = environment.for_children(domain, len(crew) + 1, log_dir)
        progress(f"domain {domain}, logs in {log_dir}")
        with Tower(domain) as tower:
            flight = _Flight(tower, stop, progress)
            began = time.monotonic()
            try:
                flight.start(crew, settings, log_dir, began + options.patience_s)
                took_off = time.monotonic()
                flight.watch(options.scenario.duration_s)
                landed = time.monotonic()
            finally:
                flight.end()
    return flight.result(options, took_off - began, landed - took_off)


def _refuse_nonsense(options: FleetOptions) -> None:
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


class _Flight:
    """The running processes."""

    def __init__(self, tower: Tower, stop: StopRequest, progress: Report) -> None:
        self._tower = tower
        self._stop = stop
        self._progress = progress
        self._children: list[Child] = []
        self._died: list[Child] = []
        self._refusal: str | None = "/formation/start was not called"

    def start(
        self,
        crew: Sequence[Command],
        settings: Mapping[str, str],
        log_dir: Path,
        deadline: float,
    ) -> None:
        """Start all processes, a few at a time, wait until all are ready, and start the flight."""
        # Half of a process's start is loading, half is waiting until it is heard of.
        at_once = 2 * (os.cpu_count() or 1)
        for command in crew:
            while len(self._silent()) >= at_once and self._patient(deadline):
                pass
            if self._stop.came:
                return
            self._children.append(Child(command, settings, log_dir))
            if command.managed is not None:
                self._tower.manage(command.name, command.managed)
        names = [command.name for command in crew if command.name != RECORDER]
        while self._tower.missing(names) and self._patient(deadline):
            pass
        while self._refusal and self._patient(deadline):
            self._refusal = self._tower.start(patience_s=2.0)
        if not self._stop.came:
            self._progress(f"{len(crew)} processes are ready: started")

    def watch(self, duration_s: float) -> None:
        """Until the sim has flown the whole flight, real vehicles have landed, or a signal."""
        if not any(child.command.ends for child in self._children):
            return
        over_s = time.monotonic() + duration_s + _AFTER_START_S
        bridged = self._child(SIM) is None
        while self._flying() and not self._stop.came:
            self._look()
            if bridged and time.monotonic() > over_s:
                return

    def _flying(self) -> bool:
        ends = any(child.command.ends and child.exit_code is None for child in self._children)
        uavs = [child for child in self._children if child.command.uav is not None]
        return ends and any(child not in self._died for child in uavs)

    def _look(self) -> None:
        self._tower.spin(_LOOK_S)
        self._tell()
        self._end_stuck()
        self._mourn()

    def _end_stuck(self) -> None:
        """End UAVs for which a lock-step flight waits in vain (`standstill`)."""
        for name in self._tower.stuck():
            child = self._child(name)
            if child is not None and child.command.uav is not None and child.exit_code is None:
                self._progress(f"{name} (pid {child.pid}) is stuck: it is ended")
                child.send(signal.SIGKILL)

    def _child(self, name: str) -> Child | None:
        return next((child for child in self._children if child.name == name), None)

    def _tell(self) -> None:
        """Pass on what the sim and the bridges say of the flight."""
        for child in self._children:
            if not child.command.ends:
                continue
            for line in child.new_lines():
                if "steps/s" in line or line.startswith(f"{child.name}: "):
                    self._progress(line)

    def _bring_down(self) -> None:
        """Land what is still in the air, before those who fly it are ended."""
        bridges = [c for c in self._children if c.command.ends and c.name != SIM]

        def airborne() -> bool:
            return any(child.exit_code is None for child in bridges)

        if not airborne():
            return
        leg = "stop" if self._stop.came else "land"
        refusal = self._tower.call(leg, _LANDING_CALL_S)
        if refusal is not None:
            self._progress(f"{refusal}: every bridge is told to land by itself")
            self._tower.emergency("land")
        patience_s, signals = time.monotonic() + _LANDING_S, self._stop.count
        while airborne() and time.monotonic() < patience_s and self._stop.count == signals:
            self._look()

    def end(self) -> None:
        """End all, the recorder last, so that its bag has everything and is complete."""
        self._bring_down()
        self._tell()
        end([child for child in self._children if child.name != RECORDER])
        end(self._children, _RECORDER_PATIENCE_S)
        for child in self._children:
            if child.exit_code != 0 and child not in self._died:
                self._died.append(child)
                self._progress(f"at the end: {child.obituary()}")

    def result(self, options: FleetOptions, startup_s: float, flight_s: float) -> FleetResult:
        """What to tell about it all."""
        reports = [
            ProcessReport(child.name, child.pid, child.exit_code, child.log)
            for child in self._children
        ]
        return FleetResult(
            processes=tuple(reports),
            died=tuple(child.name for child in self._died),
            lost=tuple(dict.fromkeys(u for c in self._died if (u := c.command.uav) is not None)),
            interrupted=self._stop.came,
            bag=options.bag,
            recorded=self._recorded(),
            startup_s=startup_s,
            flight_s=flight_s,
        )

    def _silent(self) -> list[str]:
        """Processes that have been started but not heard of: they load the CPU."""
        heard = self._tower.waiting
        return [
            child.name
            for child in self._children
            if child.name not in heard and not (child.name == RECORDER and child.says("ready"))
        ]

    def _patient(self, deadline: float) -> bool:
        """Wait a little; False when a signal has come, FleetError when it takes too long."""
        self._tower.spin(_LOOK_S)
        self._tell()
        for child in self._children:
            if child.exit_code is not None and not self._stop.came:
                raise FleetError(f"before the flight: {child.obituary()}")
            if child.name in self._tower.refused:
                raise FleetError(
                    f"{child.name} refused to be activated, {child.log}\n{child.tail()}"
                )
        if time.monotonic() > deadline:
            raise FleetError(self._late())
        return not self._stop.came

    def _late(self) -> str:
        waiting = self._tower.missing(
            child.name for child in self._children if child.name != RECORDER
        )
        if not waiting:
            return f"all are ready, but {self._refusal}"
        lines = [f"not ready in time: {', '.join(waiting)}"]
        for child in self._children:
            if child.name in waiting:
                lines.append(f"  {child.name} waits for {waiting[child.name]}; {child.log}")
        tail = next(child.tail() for child in self._children if child.name in waiting)
        return "\n".join([*lines, tail])

    def _mourn(self) -> None:
        """Tell of every process that has ended before its time; the others fly on without it."""
        for child in self._children:
            code = child.exit_code
            if code is None or child in self._died or (child.command.ends and code == 0):
                continue
            self._died.append(child)
            self._progress(child.obituary())
            uav = child.command.uav
            self._tower.lose(child.name if uav is None else f"uav{uav}")

    def _recorded(self) -> Mapping[str, Any]:
        recorder = next((child for child in self._children if child.name == RECORDER), None)
        summary = recorder.last_line() if recorder else ""
        try:
            found = json.loads(summary)
        except ValueError:  # it was killed before it could tell
            return {}
        return found if isinstance(found, dict) else {}
