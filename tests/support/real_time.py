"""Whether a flight in real time had a machine: a test that fails while others have it is not judged.

While a test marked `alone` runs, `scheduling_probe.py` runs beside it at the same priority. Only a failure is looked
at, and it remains one unless both are true:

- A process that has little to do in every control period was late with it by more than a whole period in one period
  of a hundred, or once by as long as a flight controller waits for a setpoint: a fleet cannot keep its periods then.
- It was not the test that took the processors: programs that it did not start, or the hypervisor, had a tenth of the
  time of all cores. An idle machine gives them less than three percent, a busy loop on eight cores takes twelve.

So on an idle machine every failure is a failure, that of a test which starves itself included. How fast the cores were
is told with it: a host that is shared can halve its clock.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path
from typing import NamedTuple

import pytest
from scheduling_probe import PERIOD_S

LONGEST_S = 0.5
"""After as long without a setpoint a flight controller leaves the flight."""
OTHERS = 0.1
NOT_JUDGED = "not judged"
_TICKS = os.sysconf("SC_CLK_TCK")


class Usage(NamedTuple):
    """Time of processors so far, in seconds."""

    all_s: float  # of the cores that we may use, idle or not
    idle_s: float
    ours_s: float  # of this process and all that it has started

    def minus(self, before: Usage) -> Usage:
        return Usage(*(now - then for now, then in zip(self, before, strict=True)))

    @property
    def others(self) -> float:
        """The share that neither was idle nor ours; what the hypervisor took is part of it."""
        if self.all_s <= 0.0:
            return 0.0
        return max(self.all_s - self.idle_s - self.ours_s, 0.0) / self.all_s


class Cores(NamedTuple):
    """By how much a process was late with the work of a period, and how fast the slowest core was."""

    p99_s: float
    longest_s: float
    rounds_a_s: float  # of the work of the probe


def taken(cores: Cores, usage: Usage) -> bool:
    """Whether others had the machine."""
    late = cores.p99_s > PERIOD_S or cores.longest_s > LONGEST_S
    return late and usage.others > OTHERS


def evidence(cores: Cores, usage: Usage) -> str:
    return (
        f"scheduling delay p99 {cores.p99_s * 1e3:.1f} ms, longest {cores.longest_s * 1e3:.0f} ms; "
        f"other programs and the hypervisor had {usage.others:.0%} of the processors; "
        f"the slowest core did {cores.rounds_a_s / 1e6:.1f} million rounds of the probe's work a second"
    )


def usage() -> Usage:
    """Usage up to now."""
    cores = {f"cpu{core}" for core in os.sched_getaffinity(0)}
    total = idle = 0
    for line in Path("/proc/stat").read_text(encoding="ascii").splitlines():
        name, *fields = line.split()
        if name in cores:
            ticks = [int(field) for field in fields[:8]]  # guests are in the first two already
            total += sum(ticks)
            idle += ticks[3] + ticks[4]
    return Usage(total / _TICKS, idle / _TICKS, _ours_s())


def _ours_s() -> float:
    """Of this process, of its children that have ended, and of those that still run."""
    done = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    parents, used = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                fields = (entry / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
            except OSError:
                continue
            parents[int(entry.name)] = int(fields[1])
            used[int(entry.name)] = sum(map(int, fields[11:15])) / _TICKS  # with its own children
    running = 0.0
    for process in used:
        ancestor = parents[process]
        while ancestor not in (0, os.getpid()):
            ancestor = parents.get(ancestor, 0)
        if ancestor:
            running += used[process]
    return sum(one.ru_utime + one.ru_stime for one in done) + running


class Probe:
    """`scheduling_probe.py` on each core that we may use; what it measured since it was last asked."""

    def __init__(self) -> None:
        program = str(Path(__file__).with_name("scheduling_probe.py"))
        self._processes = [
            subprocess.Popen(
                [sys.executable, "-S", program, str(core)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for core in os.sched_getaffinity(0)
        ]

    def ask(self) -> Cores:
        found, rounds_a_s = [], []
        for process in self._processes:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write("\n")
            process.stdin.flush()
            answer = json.loads(process.stdout.readline())
            found += answer["delays_s"]
            rounds_a_s.append(answer["rounds_a_s"])
        if not found:
            return Cores(0.0, 0.0, 0.0)
        found.sort()
        return Cores(found[int(0.99 * (len(found) - 1))], found[-1], min(rounds_a_s))

    def close(self) -> None:
        for process in self._processes:
            process.communicate()


class RealTime:
    """The plugin."""

    def __init__(self) -> None:
        self._probe: Probe | None = None
        self._before = Usage(0.0, 0.0, 0.0)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        if "alone" in item.keywords:
            self._probe = self._probe or Probe()
            self._probe.ask()
            self._before = usage()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        if "alone" in item.keywords and self._probe and report.failed and report.when != "teardown":
            used = usage().minus(self._before)
            cores = self._probe.ask()
            report.sections.append(("the machine", evidence(cores, used)))
            if taken(cores, used):
                report.not_judged = evidence(cores, used)
                report.outcome = "skipped"  # neither passed nor failed; its category is below
        return report

    def pytest_report_teststatus(self, report: pytest.TestReport) -> tuple[str, str, str] | None:
        return (NOT_JUDGED, "N", "NOT JUDGED") if hasattr(report, "not_judged") else None

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        for report in terminalreporter.stats.get(NOT_JUDGED, ()):
            terminalreporter.section(f"{NOT_JUDGED}: {report.nodeid}")
            terminalreporter.line(report.longreprtext)
            terminalreporter.line(f"{NOT_JUDGED}: the machine was taken away: {report.not_judged}")

    def pytest_sessionfinish(self) -> None:
        if self._probe:
            self._probe.close()


def pytest_configure(config: pytest.Config) -> None:
    """For `-p real_time`."""
    config.pluginmanager.register(RealTime())
