"""The processes of a flight, those of them that this computer runs, and their command lines."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.comm.topics import RECORDER, SIM
from ptnsbc_nodes.fleet.child_process import ProcessCommand
from ptnsbc_nodes.runtime.provenance import provenance
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.legs import starts_by_clock

BRIDGE = "ptnsbc_nodes.bridge.bridge_main"
_UAV = "ptnsbc_nodes.uav.uav_main"
_AIRBORNE_S = 240.0  # boot, position, arming and take-off of a real vehicle


class ProcessListError(PtnsbcError):
    """A name in --only of which the flight has no process."""


@dataclass(frozen=True)
class FleetOptions:
    """The scenario to fly, and how it is flown."""

    scenario: Scenario
    lockstep: bool = False
    backend: Literal["sim", "mavlink"] = "sim"
    allow_arming: bool = False  # of real vehicles
    bag: Path | None = None  # folder to record into
    overwrite: bool = False  # replace that folder
    log_dir: Path | None = None  # one log per process; a new temporary folder by default
    meta: Mapping[str, str] = field(default_factory=dict)  # into the bag, beside our own
    ready_timeout_s: float | None = None  # from the first process to the last one ready
    processes: int | None = None  # for the UAVs of this fleet; one for each by default
    only: frozenset[str] = frozenset()  # names of the processes of this computer, see `chosen`
    operator: bool = False  # offer the fleet in the types of ptnsbc_interfaces
    wait: bool = False  # an operator starts the flight, not the launcher
    namespace: str = ""  # of all nodes and topics, for example "/blue"
    # In real time: why the scenario with the measured starts must not be flown, empty when it may.
    objection: Callable[[Scenario], str] | None = None
    # Makes the live view that runs beside the flight, from the environment of the processes and the scenario file.
    beside: Callable[[Mapping[str, str], Path], AbstractContextManager[object]] | None = None

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
        if self.backend == "mavlink":
            default += _AIRBORNE_S
        return default if self.ready_timeout_s is None else self.ready_timeout_s


def commands(options: FleetOptions, scenario_file: Path) -> list[ProcessCommand]:
    """The processes of this computer in the order of their start.

    The recorder comes first, because it must miss nothing. The sim comes last: in real time a UAV ticks from its
    first odometry on, and twenty ticking UAVs make the others load three times as long.
    """
    scenario, bridged = options.scenario, options.backend == "mavlink"
    common = ["--scenario", str(scenario_file)]
    common += ["--lockstep"] if options.lockstep else []
    common += ["--recorded"] if options.recorded else []
    listed = [] if options.bag is None else [_recorder(options, options.bag, scenario_file)]
    if bridged:
        common.append("--bridged")
        arming = ["--allow-arming"] if options.allow_arming else []
        for uav in scenario.uav_ids:
            words = (*common, "--uav", str(uav), "--managed", *arming)
            managed = f"/uav{uav}/bridge"
            listed.append(ProcessCommand(f"bridge{uav}", BRIDGE, words, (uav,), managed, ends=True))
    for group in groups(options):
        words, first = (*common, "--uav", *map(str, group)), group[0]
        if len(group) == 1:
            managed = f"/uav{first}/controller"
            listed.append(
                ProcessCommand(f"uav{first}", _UAV, (*words, "--managed"), group, managed)
            )
        else:
            # They activate themselves: fifty nodes of one process answer fifty requests one after the other, and the
            # last answers come too late.
            listed.append(ProcessCommand(f"uav{first}-{group[-1]}", _UAV, words, group))
    if not bridged:
        listed.append(ProcessCommand(SIM, "ptnsbc_nodes.sim.sim_main", tuple(common), ends=True))
    here = [one for one in listed if not options.only or one.name in options.only]
    if options.operator and options.leads:
        words = ("--scenario", str(scenario_file))
        here.append(
            ProcessCommand("operator", "ptnsbc_nodes.view.operator_main", words, beside=True)
        )
    secured = scenario.security == "required"
    return [command.within(options.namespace, secured=secured) for command in here]


def names(scenario: Scenario, backend: str) -> list[str]:
    """All processes of a flight on all computers, the recorder first."""
    ids = scenario.uav_ids
    vehicles = [f"bridge{i}" for i in ids] if backend == "mavlink" else [SIM]
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
        for fault in options.scenario.faults or ():
            if fault.kind == "restart" and fault.struck_uav is not None:
                window = map(str, fault.window_ns(0))
                arguments += ["--silent", str(fault.struck_uav), *window]
    if options.backend == "mavlink":
        arguments += ["--draw", str(scenario_file)]
    chosen = {
        "--truth": options.scenario.imperfect or options.backend == "mavlink",
        "--slots": options.scenario.formation.has_open_slots,
        "--stream": options.scenario.takes_setpoints,
        "--signed": options.scenario.security == "signed",
        "--overwrite": options.overwrite,
    }
    arguments += [flag for flag, on in chosen.items() if on]
    return ProcessCommand(RECORDER, "ptnsbc_nodes.recording.recorder_main", tuple(arguments))
