"""The processes of a flight on this computer: started, watched, ended in order.

Where other computers fly the rest, the one with the recorder leads: it waits for everybody, starts the
flight, ends it, and tells the others. Each computer starts and ends its own processes.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.comm.endpoints import RECORDER, sent_in
from ptnsbc_nodes.fleet.child_process import ChildProcess, ProcessCommand, end
from ptnsbc_nodes.fleet.coordinator_node import Coordinator
from ptnsbc_nodes.fleet.process_list import SIM, FleetOptions, names
from ptnsbc_nodes.runtime.signals import StopRequest

Report = Callable[[str], None]

_LOOK_S = 0.05
_AFTER_START_S = 1.0  # the epoch is half a second after the call
_LANDING_CALL_S = 3.0
_LANDING_S = 240.0
_RECORDER_PATIENCE_S = 60.0  # what is still queued belongs into the bag
_OVER_S = 3.0
_REMINDER_S = 10.0


class FleetError(PtnsbcError):
    """A fleet that could not take off."""


class Supervisor:
    """The running processes of this computer."""

    def __init__(
        self, options: FleetOptions, tower: Coordinator, stop: StopRequest, progress: Report
    ) -> None:
        self.children: list[ChildProcess] = []
        self.died: list[ChildProcess] = []
        self.lost_elsewhere: list[str] = []  # UAVs that have ended on other computers
        self._options = options
        self._tower = tower
        self._stop = stop
        self._progress = progress
        everybody = names(options.scenario, options.backend) if options.shared else []
        self._elsewhere = [name for name in everybody if name not in options.only]
        self._told: set[str] = set()  # processes whose end has been told
        self._refusal: str | None = "/formation/start was not called"
        self._reminder = time.monotonic() + _REMINDER_S
        self._was_led = False
        if options.shared:
            tower.share(leads=options.leads)

    def start(
        self,
        crew: Sequence[ProcessCommand],
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
            self.children.append(ChildProcess(command, settings, log_dir))
            if command.managed is not None:
                self._tower.manage(command.name, command.managed)
        if self._options.leads:
            self._take_off(deadline)
        else:
            self._line_up(deadline)

    def _take_off(self, deadline: float) -> None:
        awaited = self._awaited()
        while self._tower.missing(awaited) and self._patient(deadline):
            pass
        while self._refusal and self._patient(deadline):
            self._refusal = self._tower.start(patience_s=2.0)
        if not self._stop.came:
            self._progress(
                f"{len(self.children) + len(self._elsewhere)} processes are ready: started"
            )

    def _line_up(self, deadline: float) -> None:
        while self._silent() and self._patient(deadline):
            pass
        if not self._stop.came:
            mine = ", ".join(child.name for child in self.children)
            self._progress(f"{mine}: running; the computer with the recorder starts the flight")

    def watch(self, duration_s: float) -> None:
        """Until the sim has flown the whole flight, real vehicles have landed, or a signal."""
        if not self._options.leads:
            self._attend()
            return
        over_s = time.monotonic() + duration_s + _AFTER_START_S
        bridged = self._options.backend == "mavlink"
        while self._flying() and not self._stop.came:
            self._look()
            if bridged and time.monotonic() > over_s:
                return

    def _attend(self) -> None:
        """Until the launcher that leads says so, or is gone, or a signal."""
        while not (self._tower.over or self._stop.came or self._abandoned()):
            self._look()
            if all(child.exit_code is not None for child in self.children):
                return

    def _abandoned(self) -> bool:
        if self._tower.led:
            self._was_led = True
            return False
        if not self._was_led:
            return False
        self._was_led = False  # said once
        self._progress("the computer with the recorder is gone")
        # Real vehicles fly on: whether they land is for their operator to say.
        return self._options.backend == "sim"

    def _flying(self) -> bool:
        """Whether something still flies, of what this computer knows."""
        there = [name for name in self._elsewhere if name not in self._tower.gone]
        running = [child for child in self.children if child.exit_code is None]
        ends = any(child.command.ends for child in running)
        uavs = [child for child in self.children if child.command.uav is not None]
        return (ends or any(not name.startswith("uav") for name in there)) and (
            any(child not in self.died for child in uavs)
            or any(name.startswith("uav") for name in there)
        )

    def _look(self) -> None:
        self._tower.spin(_LOOK_S)
        self._tell()
        self._end_stuck()
        self._mourn()

    def _end_stuck(self) -> None:
        """End UAVs for which a lock-step flight waits in vain (`standstill`)."""
        stuck = self._tower.stuck()
        for child in self.children:
            if child.name in stuck and child.command.uav is not None and child.exit_code is None:
                self._progress(f"{child.name} (pid {child.pid}) is stuck: it is ended")
                child.send(signal.SIGKILL)

    def _tell(self) -> None:
        """Pass on what the sim and the bridges say of the flight."""
        for child in self.children:
            if not child.command.ends:
                continue
            for line in child.new_lines():
                if "steps/s" in line or line.startswith(f"{child.name}: "):
                    self._progress(line)

    def _bring_down(self) -> None:
        """Land what is still in the air, before those who fly it are ended."""
        bridges = [c for c in self.children if c.command.ends and c.name != SIM]

        def airborne() -> bool:
            away = (name for name in self._elsewhere if name.startswith("bridge"))
            return any(child.exit_code is None for child in bridges) or (
                self._options.leads and any(name not in self._tower.gone for name in away)
            )

        if not airborne():
            return
        if self._options.leads:
            self._call_down()
        elif not self._tower.over:  # only the vehicles of this computer: others fly on
            for bridge in bridges:
                bridge.send(signal.SIGINT)
        patience_s, signals = time.monotonic() + _LANDING_S, self._stop.count
        while airborne() and time.monotonic() < patience_s and self._stop.count == signals:
            self._look()

    def _call_down(self) -> None:
        leg = "stop" if self._stop.came else "land"
        refusal = self._tower.call(leg, _LANDING_CALL_S)
        if refusal is not None:
            self._progress(f"{refusal}: every bridge is told to land by itself")
            self._tower.emergency("land")

    def end(self) -> None:
        """End all, the recorder last, so that its bag has everything and is complete."""
        self._bring_down()
        self._tell()
        self._tower.end(_OVER_S)
        end([child for child in self.children if child.name != RECORDER])
        end(self.children, _RECORDER_PATIENCE_S)
        for child in self.children:
            if child.exit_code == 0 or child in self.died:
                continue
            if child.exit_code == -signal.SIGKILL and _had_finished(child):
                self._progress(
                    f"{child.name} (pid {child.pid}) had finished and did not go: killed"
                )
            else:
                self.died.append(child)
                self._progress(f"at the end: {child.obituary()}")

    def _awaited(self) -> list[str]:
        """Who must be ready before the flight."""
        mine = [child.name for child in self.children]
        return [name for name in (*mine, *self._elsewhere) if name != RECORDER]

    def _silent(self) -> list[str]:
        """Processes that have been started but not heard of: they load the CPU."""
        heard = self._tower.waiting
        return [
            child.name
            for child in self.children
            if child.name not in heard and not (child.name == RECORDER and child.says("ready"))
        ]

    def _patient(self, deadline: float) -> bool:
        """Wait a little; False when a signal has come, FleetError when it takes too long."""
        self._tower.spin(_LOOK_S)
        self._tell()
        for child in self.children:
            if child.exit_code is not None and not self._stop.came:
                raise FleetError(f"before the flight: {child.obituary()}")
            if child.name in self._tower.refused:
                raise FleetError(
                    f"{child.name} refused to be activated, {child.log}\n{child.tail()}"
                )
        if time.monotonic() > deadline:
            raise FleetError(self._late())
        if self._options.shared and time.monotonic() > self._reminder:
            self._reminder = time.monotonic() + _REMINDER_S
            self._progress("\n".join(self._waiting_for()) or f"all are ready, but {self._refusal}")
        return not self._stop.came

    def _late(self) -> str:
        lines = self._waiting_for()
        if not lines:
            return f"all are ready, but {self._refusal}"
        late = self._tower.missing(self._awaited())
        tail = [child.tail() for child in self.children if child.name in late][:1]
        return "\n".join([f"not ready in time: {', '.join(late)}", *lines, *tail])

    def _waiting_for(self) -> list[str]:
        waiting = self._tower.missing(self._awaited())
        logs = {child.name: str(child.log) for child in self.children}
        return [
            f"  {name} waits for {what}; {logs.get(name, 'on another computer')}"
            for name, what in waiting.items()
        ]

    def _mourn(self) -> None:
        """Tell of every process that has ended before its time; the others fly on without it."""
        for child in self.children:
            code = child.exit_code
            if code is None or child.name in self._told:
                continue
            self._told.add(child.name)
            lost = {child.name} if self._options.shared else set()
            if not (child.command.ends and code == 0):
                self.died.append(child)
                self._progress(child.obituary())
                lost.add(child.command.lost)
            for name in lost:
                self._tower.lose(name)
        for name in self._tower.gone.intersection(self._elsewhere) - self._told:
            self._told.add(name)
            self._progress(f"{name} has ended, on another computer")
            if name.startswith("uav"):
                self.lost_elsewhere.append(name)


def _had_finished(child: ChildProcess) -> bool:
    """Whether the last it said is what it had done: the middleware does not always let go of a process."""
    last = child.last_line()
    return last.startswith("{") if child.name == RECORDER else sent_in([last]) is not None
