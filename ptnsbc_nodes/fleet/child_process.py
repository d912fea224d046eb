"""The processes of a fleet: started, watched, ended; each with a log file of its own."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

_TAIL_LINES = 12
# As `python -m`, but without the current folder on the path: a yaml.py that lies there is nobody's YAML.
# (`python -P` does the same, from Python 3.11 on.)
_RUN_MODULE = (
    "import sys; sys.path[:] = filter(None, sys.path); import runpy; "
    "runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
)
_PATIENCE_S = 10.0
# What a process is given to end in after the harder signals.
_HARDER = {signal.SIGTERM: 3.0, signal.SIGKILL: 5.0}


@dataclass(frozen=True)
class ProcessCommand:
    """A Python module to run as a process."""

    name: str  # of the process, in messages and of its log
    module: str
    arguments: tuple[str, ...]
    uav: int | None = None  # id of the UAV that ends with it
    managed: str | None = None  # its node below the fleet, when the launcher drives its life cycle
    ends: bool = False  # by itself, with 0, when the flight is over

    @property
    def lost(self) -> str:
        """Whom the flight has lost with it: a bridge takes its UAV along."""
        return self.name if self.uav is None else f"uav{self.uav}"


EXECUTABLES = {
    "ptnsbc_nodes.uav.main": "uav",
    "ptnsbc_nodes.sim.main": "sim",
    "ptnsbc_nodes.recording.main": "recorder",
    "ptnsbc_nodes.bridge.main": "bridge",
    "ptnsbc_nodes.fleet.main": "fleet",
    "ptnsbc_nodes.fleet.coordinator_main": "tower",
}
"""What `ros2 run ptnsbc_nodes`, `ptnsbc node` and launch files call each module."""


class ChildProcess:
    """One running process."""

    def __init__(
        self, command: ProcessCommand, environment: Mapping[str, str], log_dir: Path
    ) -> None:
        self.command = command
        self.name = command.name
        self.log = log_dir / f"{command.name}.log"
        self._read = 0
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _RUN_MODULE, command.module, *command.arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=dict(environment),
                # The terminal's Ctrl-C is for the launcher, which ends the fleet in order.
                start_new_session=True,
            )
        self.pid = self._process.pid

    @property
    def exit_code(self) -> int | None:
        """None while it runs; minus the signal's number when one ended it."""
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

    def says(self, line: str) -> bool:
        """Whether its log has this line."""
        return line in self.log.read_text(errors="replace").splitlines()

    def last_line(self) -> str:
        """The last line of its log so far."""
        return "".join(self.log.read_text(errors="replace").splitlines()[-1:])

    def tail(self) -> str:
        """The last lines of the log, indented."""
        lines = self.log.read_text(errors="replace").splitlines()[-_TAIL_LINES:]
        return "\n".join(f"    {line}" for line in lines) or "    (its log is empty)"

    def obituary(self) -> str:
        """Who it was, how it ended, and its last words."""
        code = self.exit_code
        how = f"exit code {code}"
        if code is not None and code < 0:
            how = f"signal {signal.Signals(-code).name}"
        return f"{self.name} (pid {self.pid}) has ended: {how}, {self.log}\n{self.tail()}"


def end(children: Sequence[ChildProcess], patience_s: float = _PATIENCE_S) -> None:
    """End processes together, ever harder; none is left when this returns.

    Args:
        children: Those that have ended already are left alone.
        patience_s: Time they have to end by themselves after SIGINT.
    """
    for number, limit_s in {signal.SIGINT: patience_s, **_HARDER}.items():
        left = [child for child in children if child.exit_code is None]
        for child in left:
            child.send(number)
        deadline = time.monotonic() + limit_s
        for child in left:
            child.wait(deadline - time.monotonic())
