"""The processes of a fleet: those of them that this computer runs, their command lines, their start and their end."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.comm.topics import RECORDER, SIM
from ptnsbc_nodes.runtime.launcher import REPORT, Reports
from ptnsbc_nodes.runtime.provenance import provenance
from ptnsbc_nodes.runtime.signals import signals_blocked
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.legs import starts_by_clock

BRIDGE = "ptnsbc_nodes.bridge.bridge_main"
UAV = "ptnsbc_nodes.uav.uav_main"
_AIRBORNE_S = 240.0  # boot, position, arming and take-off of a real vehicle
_TAIL_LINES = 12
_USER_ERROR = 2  # the exit code of a process that ended with a message to the user
# By rclpy: level, time and node.
_LOGGED = re.compile(r"(\[\w+\] )\[(\d{1,11})[\d.]*\] \[[\w./]+\]: ")
_FIGURE = re.compile(r"\d+(\.\d+)?")  # differs between messages of one cause
# As `python -m`, but without the current folder on the path: a yaml.py that lies there is not imported.
# (`python -P` does the same, from Python 3.11 on.)
_RUN_MODULE = (
    "import sys; sys.path[:] = filter(None, sys.path); import runpy; "
    "runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
)
_PATIENCE_S = 10.0
_LOOK_S = 0.1
# The time that a process has to end after each of the harder signals.
_HARDER = {signal.SIGTERM: 3.0, signal.SIGKILL: 5.0}


@dataclass(frozen=True)
class ProcessCommand:
    """A Python module to run as a process."""

    name: str  # of the process, in messages and of its log
    module: str
    arguments: tuple[str, ...]
    uavs: tuple[int, ...] = ()  # ids of the UAVs that are lost when it ends
    ends: bool = False  # by itself, with 0, when the flight is over

    def within(self, namespace: str) -> ProcessCommand:
        """The same process with its node in the namespace of a fleet."""
        words: list[str] = []
        if namespace and len(self.uavs) < 2:
            words += ["-r", f"__ns:={namespace}" + "".join(f"/uav{uav}" for uav in self.uavs)]
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
    "ptnsbc_nodes.fleet.coordinator_main": "coordinator",
}
"""The name of each module in `ros2 run ptnsbc_nodes`, `ptnsbc network node` and launch files."""


class ProcessListError(PtnsbcError):
    """A name in --only of which the flight has no process."""


@dataclass(frozen=True)
class FleetOptions:
    """The scenario to fly, and how it is flown."""

    scenario: Scenario
    lockstep: bool = False
    backend: Literal["sim", "mavlink", "ros"] = "sim"
    allow_arming: bool = False  # of real vehicles
    bag: Path | None = None  # folder to record into
    overwrite: bool = False  # replace that folder
    log_dir: Path | None = None  # one log per process; a new temporary folder by default
    meta: Mapping[str, str] = field(default_factory=dict)  # into the bag, beside our own
    ready_timeout_s: float | None = None  # from the first process to the last one ready
    processes: int | None = None  # for the UAVs of this fleet; one for each by default
    only: frozenset[str] = frozenset()  # names of the processes of this computer, see `chosen`
    wait: bool = False  # an operator starts the flight, not the launcher
    namespace: str = ""  # of all nodes and topics, for example "/blue"
    # In real time: why the scenario with the measured starts must not be flown, empty when it may.
    objection: Callable[[Scenario], str] | None = None
    # Makes the live view that runs beside the flight, from the environment of the processes and the scenario file.
    beside: Callable[[Mapping[str, str], Path], AbstractContextManager[object]] | None = None

    @property
    def bridged(self) -> bool:
        """True if real vehicles fly, each behind a bridge."""
        return self.backend != "sim"

    @property
    def shared(self) -> bool:
        """True if other computers run the rest of the fleet."""
        return bool(self.only)

    @property
    def leads(self) -> bool:
        """True if this computer starts and ends the flight: the one that records it."""
        return not self.only or RECORDER in self.only

    @property
    def elsewhere(self) -> list[str]:
        """Names of the processes that other computers run."""
        everywhere = names(self.scenario, self.backend) if self.shared else []
        return [name for name in everywhere if name not in self.only]

    @property
    def recorded(self) -> bool:
        """True if a recorder listens, here or elsewhere."""
        return self.bag is not None or self.shared

    @property
    def starts_by_clock(self) -> bool:
        """True if the mission begins at a time in UTC: in real time, where it names one."""
        return not self.lockstep and starts_by_clock(self.scenario.mission)

    @property
    def patience_s(self) -> float:
        """The time-out, by default with room for a slow machine."""
        if self.shared and self.ready_timeout_s is None:
            return math.inf  # people start the other computers
        default = 30.0 + 5.0 * len(self.scenario.uav_ids)
        if self.bridged:
            default += _AIRBORNE_S
        return default if self.ready_timeout_s is None else self.ready_timeout_s


def commands(options: FleetOptions, scenario_file: Path) -> list[ProcessCommand]:
    """The processes of this computer in the order of their start.

    The recorder comes first, because it must miss nothing. Bridges come before UAVs, without which they arm nothing.
    The sim comes last: in real time a UAV ticks from its first odometry on, and twenty ticking UAVs make the others
    load three times as long.
    """
    scenario, bridged = options.scenario, options.bridged
    common = ["--scenario", str(scenario_file)]
    common += ["--lockstep"] if options.lockstep else []
    common += ["--recorded"] if options.recorded else []
    listed = [] if options.bag is None else [_recorder(options, options.bag, scenario_file)]
    if bridged:
        common.append("--bridged")
        arming = ["--allow-arming"] if options.allow_arming else []
        for uav in scenario.uav_ids:
            words = (*common, "--uav", str(uav), "--with-fleet", *arming)
            listed.append(ProcessCommand(f"bridge{uav}", BRIDGE, words, (uav,), ends=True))
    for group in groups(options):
        words, first = (*common, "--uav", *map(str, group)), group[0]
        name = f"uav{first}" if len(group) == 1 else f"uav{first}-{group[-1]}"
        listed.append(ProcessCommand(name, UAV, words, group))
    if not bridged:
        listed.append(ProcessCommand(SIM, "ptnsbc_nodes.sim.sim_main", tuple(common), ends=True))
    here = [one for one in listed if not options.only or one.name in options.only]
    return [command.within(options.namespace) for command in here]


def names(scenario: Scenario, backend: str) -> list[str]:
    """All processes of a flight on all computers, the recorder first."""
    ids = scenario.uav_ids
    vehicles = [SIM] if backend == "sim" else [f"bridge{i}" for i in ids]
    return [RECORDER, *vehicles, *(f"uav{i}" for i in ids)]


def chosen(text: str, scenario: Scenario, backend: str) -> frozenset[str]:
    """Names of processes from a list such as `recorder,sim,1,2`: a number is a UAV, with its bridge."""
    there = names(scenario, backend)
    picked: set[str] = set()
    for word in text.replace(",", " ").split():
        meant = {f"uav{word}", f"bridge{word}"} if word.isdecimal() else {word}
        if not meant.intersection(there):
            numbers = ", ".join(map(str, scenario.uav_ids))
            raise ProcessListError(
                f"--only: {word!r} is no process of {scenario.name}: expected some of "
                f"{', '.join(there)}, or the numbers of UAVs ({numbers})"
            )
        picked |= meant.intersection(there)
    if not picked:
        raise ProcessListError(f"--only: nothing named: expected some of {', '.join(there)}")
    return frozenset(picked)


def groups(options: FleetOptions) -> list[tuple[int, ...]]:
    """The UAVs of each process, in the order of their ids and as even as can be."""
    ids = options.scenario.uav_ids
    count = options.processes or len(ids)
    return [tuple(ids[k * len(ids) // count : (k + 1) * len(ids) // count]) for k in range(count)]


def _recorder(options: FleetOptions, bag: Path, scenario_file: Path) -> ProcessCommand:
    arguments = ["--bag", str(bag), "--uavs", *map(str, options.scenario.uav_ids)]
    arguments += ["--attach", f"scenario.yaml={scenario_file}"]
    mode = "lockstep" if options.lockstep else "realtime"
    meta = {"mode": mode, "scenario": options.scenario.name, **provenance(), **options.meta}
    if options.namespace:
        meta["namespace"] = options.namespace
    for key, value in meta.items():
        arguments += ["--meta", f"{key}={value}"]
    if options.lockstep:
        arguments.append("--lockstep")
        for fault in options.scenario.faults:
            if fault.kind == "restart" and fault.struck_uav is not None:
                window = map(str, fault.window_ns(0))
                arguments += ["--silent", str(fault.struck_uav), *window]
    if options.bridged:
        arguments += ["--draw", str(scenario_file)]
    chosen = {
        "--truth": options.scenario.imperfect or options.bridged,
        "--slots": options.scenario.formation.has_open_slots,
        "--stream": options.scenario.takes_setpoints,
        "--signed": options.scenario.security == "signed",
        "--overwrite": options.overwrite,
    }
    arguments += [flag for flag, on in chosen.items() if on]
    return ProcessCommand(RECORDER, "ptnsbc_nodes.recording.recorder_main", tuple(arguments))


def _with_hour(logged: re.Match[str]) -> str:
    return f"{logged[1]}{time.strftime('%H:%M:%S', time.localtime(int(logged[2])))} "


class ChildProcess:
    """One running process."""

    def __init__(
        self, command: ProcessCommand, environment: Mapping[str, str], log_dir: Path, life: int = 1
    ) -> None:
        """`life`: 2 for the process that replaces the first one, and so on; each has its own log."""
        self.command, self.life = command, life
        self.name = command.name
        self.log = log_dir / f"{command.name}{f'-{life}' if life > 1 else ''}.log"
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
        """Its exit code once it has ended; None when it has not in time.

        What it reports is taken in meanwhile: the pipe holds 64 kB, and it would wait until somebody reads.
        """
        deadline = time.monotonic() + timeout_s
        while self.exit_code is None and (left_s := deadline - time.monotonic()) > 0.0:
            self.reports.lines()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(min(left_s, _LOOK_S))
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
        """The last lines of the log, indented; of an error of the user the error alone, without its traceback.

        Messages of one cause that a node has logged are one line, the newest, with their count.
        """
        newest, counts = dict[str, str](), Counter[str]()
        for line in self.log_lines():
            text = _LOGGED.sub(_with_hour, line)  # what has long ended must not look like the end
            cause = text if text == line else _FIGURE.sub("", text)
            counts[cause] += 1
            newest.pop(cause, None)  # the newest one stands last
            newest[cause] = text
        times = {cause: f" ({count} times)" for cause, count in counts.items() if count > 1}
        lines = [text + times.get(cause, "") for cause, text in newest.items()][-_TAIL_LINES:]
        if self.exit_code == _USER_ERROR:
            prefix = f"{EXECUTABLES.get(self.command.module, self.name)}: "
            errors = [at for at, line in enumerate(lines) if line.startswith(prefix)]
            lines = lines[errors[-1] :] if errors else lines
        return "\n".join(f"    {line}" for line in lines) or "    (its log is empty)"

    @property
    def fault(self) -> str:
        """The reason why a bridge that has ended in order did not fly as planned; empty for any other process."""
        flew_otherwise = self.command.module == BRIDGE and self.exit_code
        return self.reports.summary or "" if flew_otherwise else ""

    def exit_summary(self) -> str:
        """Its name, how it ended, and the last lines of its log."""
        code = self.exit_code or 0
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        return f"{self.name} (pid {self.pid}) has ended: {how}, {self.log}\n{self.tail()}"


class Crew:
    """The processes of one launcher, in the order of their start."""

    def __init__(self, settings: Mapping[str, str], log_dir: Path) -> None:
        """`settings`: environment of the processes."""
        self.children: list[ChildProcess] = []
        self._settings, self._log_dir = settings, log_dir

    def start(self, command: ProcessCommand) -> None:
        """Start a process."""
        self.children.append(ChildProcess(command, self._settings, self._log_dir))

    def start_again(self, child: ChildProcess) -> None:
        """Start a process that has ended once more, in its place."""
        command = child.command
        if child.name == RECORDER:  # the bag that is there is its own, and empty
            command = replace(command, arguments=(*command.arguments, "--overwrite"))
        again = ChildProcess(command, self._settings, self._log_dir, child.life + 1)
        self.children[self.children.index(child)] = again

    def pass_on_lines(self, progress: Callable[[str], None]) -> None:
        """Pass on what the sim and the bridges say of the flight."""
        for child in self.children:
            if child.command.ends:
                for line in child.new_lines():
                    if line.startswith(f"{child.name}: "):
                        progress(line)


def fault_lines(children: Iterable[ChildProcess]) -> Iterator[str]:
    """A line for each cause of a flight that was not as planned; its figures differ from one bridge to the next."""
    alike: dict[str, list[ChildProcess]] = {}
    for child in children:
        if child.fault:
            alike.setdefault(_FIGURE.sub("", child.fault), []).append(child)
    for of_cause in alike.values():
        names, first = ", ".join(child.name for child in of_cause), of_cause[0]
        yield f"not as planned: {names} ({len(of_cause)}): {first.fault}; logs in {first.log.parent}"


def end(children: Sequence[ChildProcess], patience_s: float = _PATIENCE_S) -> None:
    """End processes together, by SIGINT, after `patience_s` SIGTERM, and SIGKILL; all have ended when this returns."""
    for number, limit_s in {signal.SIGINT: patience_s, **_HARDER}.items():
        left = [child for child in children if child.exit_code is None]
        for child in left:
            child.send(number)
        deadline = time.monotonic() + limit_s
        for child in left:
            child.wait(deadline - time.monotonic())
