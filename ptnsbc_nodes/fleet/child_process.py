"""The processes of a fleet: each is started with a log file of its own, watched, and ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ptnsbc_nodes.comm.topics import RECORDER
from ptnsbc_nodes.runtime.launcher import REPORT, Reports
from ptnsbc_nodes.runtime.signals import signals_blocked

if TYPE_CHECKING:
    from ptnsbc_nodes.fleet.fleet_node import LifecycleManager

_TAIL_LINES = 12
_USER_ERROR = 2  # the exit code of a process that ended with a message to the user
# As `python -m`, but without the current folder on the path: a yaml.py that lies there is not imported.
# (`python -P` does the same, from Python 3.11 on.)
_RUN_MODULE = (
    "import sys; sys.path[:] = filter(None, sys.path); import runpy; "
    "runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
)
_PATIENCE_S = 10.0
# The time that a process has to end after each of the harder signals.
_HARDER = {signal.SIGTERM: 3.0, signal.SIGKILL: 5.0}


@dataclass(frozen=True)
class ProcessCommand:
    """A Python module to run as a process."""

    name: str  # of the process, in messages and of its log
    module: str
    arguments: tuple[str, ...]
    uavs: tuple[int, ...] = ()  # ids of the UAVs that are lost when it ends
    managed: str = ""  # its node below the fleet, if the launcher drives its life cycle
    ends: bool = False  # by itself, with 0, when the flight is over
    beside: bool = False  # the flight needs it not: its end is reported, and changes nothing

    def within(self, namespace: str, *, secured: bool = False) -> ProcessCommand:
        """The same process with its node in the namespace of a fleet, and with its own identity of DDS Security."""
        words: list[str] = []
        if namespace and len(self.uavs) < 2:
            words += ["-r", f"__ns:={namespace}" + "".join(f"/uav{uav}" for uav in self.uavs)]
        if secured:
            words += ["--enclave", f"{namespace}/{self.name}"]
        # A remapping of ROS would move all nodes of several UAVs into one namespace.
        own = ["--fleet", namespace] if namespace and len(self.uavs) > 1 else []
        ros = ["--ros-args", *words] if words else []
        return replace(self, arguments=(*self.arguments, *own, *ros))

    @property
    def lost(self) -> tuple[str, ...]:
        """The loss to the flight when it ends: its UAVs if it belongs to some, so also for a bridge."""
        return tuple(f"uav{i}" for i in self.uavs) or (self.name,)

    @property
    def reporters(self) -> tuple[str, ...]:
        """The names under which its nodes report on /diagnostics."""
        return self.lost if len(self.uavs) > 1 else (self.name,)


EXECUTABLES = {
    "ptnsbc_nodes.uav.uav_main": "uav",
    "ptnsbc_nodes.sim.sim_main": "sim",
    "ptnsbc_nodes.recording.recorder_main": "recorder",
    "ptnsbc_nodes.bridge.bridge_main": "bridge",
    "ptnsbc_nodes.fleet.fleet_main": "fleet",
    "ptnsbc_nodes.fleet.coordinator_main": "coordinator",
    "ptnsbc_nodes.view.operator_main": "operator",
}
"""The name of each module in `ros2 run ptnsbc_nodes`, `ptnsbc node` and launch files."""


class ChildProcess:
    """One running process."""

    def __init__(
        self, command: ProcessCommand, environment: Mapping[str, str], log_dir: Path
    ) -> None:
        self.command = command
        self.name = command.name
        self.log = log_dir / f"{command.name}.log"
        self._read = 0
        self.reports = Reports()
        try:
            # A signal that comes before the process has its handlers waits for them.
            with self.log.open("wb") as log, signals_blocked():
                self._process = subprocess.Popen(
                    [sys.executable, "-c", _RUN_MODULE, command.module, *command.arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    env={**environment, REPORT: str(self.reports.writer)},
                    pass_fds=(self.reports.writer,),
                    # The terminal's Ctrl-C is for the launcher, which ends the fleet in order.
                    start_new_session=True,
                )
        finally:
            os.close(self.reports.writer)
        self.pid = self._process.pid

    @property
    def exit_code(self) -> int | None:
        """None while it runs; minus the signal's number when a signal ended it."""
        return self._process.poll()

    def wait(self, timeout_s: float) -> int | None:
        """Its exit code once it has ended; None when it has not in time."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(max(timeout_s, 0.0))
        return self.exit_code

    def send(self, number: signal.Signals) -> None:
        """Send a signal, if it still runs."""
        self._process.send_signal(number)

    def new_lines(self) -> list[str]:
        """Complete lines of the log since the last call."""
        with self.log.open("rb") as log:
            log.seek(self._read)
            whole, newline, _ = log.read().rpartition(b"\n")
        self._read += len(whole) + len(newline)
        return whole.decode(errors="replace").splitlines()

    @property
    def log_size(self) -> int:
        """The size of its log [bytes]."""
        return self.log.stat().st_size

    def log_lines(self) -> list[str]:
        """All lines of its log so far."""
        return self.log.read_text(errors="replace").splitlines()

    def tail(self) -> str:
        """The last lines of the log, indented; of an error of the user the error alone, without its traceback."""
        lines = self.log_lines()[-_TAIL_LINES:]
        if self.exit_code == _USER_ERROR:
            prefix = f"{EXECUTABLES.get(self.command.module, self.name)}: "
            said = [at for at, line in enumerate(lines) if line.startswith(prefix)]
            lines = lines[said[-1] :] if said else lines
        return "\n".join(f"    {line}" for line in lines) or "    (its log is empty)"

    def exit_summary(self) -> str:
        """Its name, how it ended, and the last lines of its log."""
        code = self.exit_code
        how = f"exit code {code}"
        if code is not None and code < 0:
            how = f"signal {signal.Signals(-code).name}"
        return f"{self.name} (pid {self.pid}) has ended: {how}, {self.log}\n{self.tail()}"


class Crew:
    """The processes of one launcher, in the order of their start."""

    def __init__(
        self, settings: Mapping[str, str], log_dir: Path, lifecycle: LifecycleManager
    ) -> None:
        """`settings`: environment of the processes; `lifecycle`: takes their nodes to active."""
        self.children: list[ChildProcess] = []
        self._settings, self._log_dir, self._lifecycle = settings, log_dir, lifecycle

    def start(self, command: ProcessCommand) -> None:
        """Start a process, and take its node to active if the launcher drives its life cycle."""
        self.children.append(self._launch(command))

    def start_again(self, child: ChildProcess) -> None:
        """Start a process that has ended once more, in its place."""
        command = child.command
        if child.name == RECORDER:  # the bag that is there is its own, and empty
            command = replace(command, arguments=(*command.arguments, "--overwrite"))
        self.children[self.children.index(child)] = self._launch(command)

    def pass_on_lines(self, progress: Callable[[str], None]) -> None:
        """Pass on what the sim and the bridges say of the flight."""
        for child in self.children:
            if child.command.ends:
                for line in child.new_lines():
                    if line.startswith(f"{child.name}: "):
                        progress(line)

    def _launch(self, command: ProcessCommand) -> ChildProcess:
        child = ChildProcess(command, self._settings, self._log_dir)
        if command.managed:
            self._lifecycle.manage(command.name, command.managed)
        return child


def end(children: Sequence[ChildProcess], patience_s: float = _PATIENCE_S) -> None:
    """End processes together, by SIGINT, after `patience_s` SIGTERM, and SIGKILL; all have ended when this returns."""
    for number, limit_s in {signal.SIGINT: patience_s, **_HARDER}.items():
        left = [child for child in children if child.exit_code is None]
        for child in left:
            child.send(number)
        deadline = time.monotonic() + limit_s
        for child in left:
            child.wait(deadline - time.monotonic())
