"""Faults of processes, carried out by the launcher that has started them: signals by pid, and a full disk.

In real time the times of a scenario count from the start of the mission. In lock-step the launcher has no mission time:
a UAV carries out its own `kill` there (`UavFaults`), and nothing else of the scenario is injected.
"""

from __future__ import annotations

import resource
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from ptnsbc_nodes.fleet.child_process import ChildProcess, FleetOptions
from ptnsbc_sim.scenario.mission.fault_rules import PROCESS, RECORDER, FaultBlock

_OURS = (PROCESS, RECORDER)
_KILLED_S = 5.0
_SMALLEST_FULL_DISK = 1 << 16  # [bytes]; the log of the recorder must still fit


class FaultInjector:
    """The faults of the processes of one launcher."""

    def __init__(
        self,
        options: FleetOptions,
        report: Callable[[str], None],
        restart: Callable[[ChildProcess], None],
        steady_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """`report`: takes a line for each fault; `restart`: starts a process again that has been killed."""
        self._options, self._report, self._restart = options, report, restart
        self._steady_s = steady_s
        self._due: list[tuple[float, FaultBlock]] = []
        self._frozen: list[tuple[float, ChildProcess]] = []
        self._gone: list[tuple[float, ChildProcess]] = []  # to be started again

    def begin(self, t0_s: float) -> None:
        """The mission begins at this time of the steady clock."""
        if not self._options.lockstep:
            faults = self._options.scenario.faults
            self._due += [(t0_s + one.at_s, one) for one in faults if one.rule.strikes in _OURS]

    def look(self, children: Sequence[ChildProcess]) -> None:
        """Begin the faults that are due, and end those that are over."""
        now_s = self._steady_s()
        for due_s, fault in [one for one in self._due if one[0] <= now_s]:
            self._due.remove((due_s, fault))
            for child in children:
                names = child.name, *child.command.reporters
                if fault.victim in names and child.exit_code is None:
                    self._report(f"fault: {fault.text} (pid {child.pid})")
                    self._strike(child, fault, now_s)
        for until_s, child in [one for one in self._gone if one[0] <= now_s]:
            self._gone.remove((until_s, child))
            self._restart(child)
        for until_s, child in [one for one in self._frozen if one[0] <= now_s]:
            self._frozen.remove((until_s, child))
            child.send(signal.SIGCONT)

    def end(self) -> None:
        """Let every process go on that is frozen: it could not end otherwise."""
        for _, child in self._frozen:
            child.send(signal.SIGCONT)
        self._frozen.clear()
        self._gone.clear()
        self._due.clear()

    def comes_back(self, child: ChildProcess) -> bool:
        """True if a process that has ended is to be started again."""
        return any(child is one for _, one in self._gone)

    def _strike(self, child: ChildProcess, fault: FaultBlock, now_s: float) -> None:
        if fault.kind == "disk_full":
            self._fill_disk(child)
        elif fault.kind == "freeze":
            child.send(signal.SIGSTOP)
            self._frozen.append((now_s + (fault.duration_s or 0.0), child))
        else:
            child.send(signal.SIGKILL)
            if fault.kind == "restart":
                child.wait(_KILLED_S)
                if fault.duration_s is None:
                    self._restart(child)
                else:
                    self._gone.append((now_s + fault.duration_s, child))

    def _fill_disk(self, child: ChildProcess) -> None:
        """No file of the process grows beyond the largest that it writes."""
        bag = self._options.bag
        limit = _SMALLEST_FULL_DISK
        for file in () if bag is None else Path(f"{bag}.part").glob("*"):
            with suppress(OSError):
                limit = max(limit, file.stat().st_size)
        with suppress(OSError, ValueError):  # it may just have ended
            _, most = resource.prlimit(child.pid, resource.RLIMIT_FSIZE)
            resource.prlimit(child.pid, resource.RLIMIT_FSIZE, (limit, most))
