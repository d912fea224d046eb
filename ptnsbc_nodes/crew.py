"""Which processes a flight consists of, and their command lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ptnsbc_nodes.children import Command
from ptnsbc_nodes.endpoints import RECORDER
from ptnsbc_nodes.provenance import provenance
from ptnsbc_sim.scenario import Scenario

SIM = "sim"

_AIRBORNE_S = 240.0  # boot, position, arming and take-off of a real vehicle


@dataclass(frozen=True)
class FleetOptions:
    """What to fly, and how."""

    scenario: Scenario
    lockstep: bool = False
    backend: Literal["sim", "mavlink"] = "sim"
    allow_arming: bool = False  # of real vehicles
    bag: Path | None = None  # folder to record into
    overwrite: bool = False  # replace that folder
    log_dir: Path | None = None  # one log per process; a new temporary folder by default
    meta: Mapping[str, str] = field(default_factory=dict)  # into the bag, beside our own
    ready_timeout_s: float | None = None  # from the first process to the last one ready

    @property
    def patience_s(self) -> float:
        """The time-out, by default with room for a slow machine."""
        default = 30.0 + 5.0 * len(self.scenario.uav_ids)
        if self.backend == "mavlink":
            default += _AIRBORNE_S
        return default if self.ready_timeout_s is None else self.ready_timeout_s


def commands(options: FleetOptions, scenario_file: Path) -> list[Command]:
    """All processes in the order of their start: the recorder must miss nothing."""
    common = ["--scenario", str(scenario_file)]
    if options.lockstep:
        common.append("--lockstep")
    if options.bag is not None:
        common.append("--recorded")
    crew = [] if options.bag is None else [_recorder(options, options.bag, scenario_file)]
    if options.backend == "mavlink":
        common.append("--bridged")
        crew += [_bridge(options, common, i) for i in options.scenario.uav_ids]
    else:
        crew.append(Command(SIM, "ptnsbc_nodes.sim_node", tuple(common), ends=True))
    for i in options.scenario.uav_ids:
        arguments = (*common, "--uav", str(i), "--managed")
        node = f"/uav{i}/controller"
        crew.append(Command(f"uav{i}", "ptnsbc_nodes.uav_node", arguments, uav=i, managed=node))
    return crew


def _bridge(options: FleetOptions, common: Sequence[str], uav: int) -> Command:
    arguments = [*common, "--uav", str(uav), "--managed"]
    if options.allow_arming:
        arguments.append("--allow-arming")
    name = f"bridge{uav}"
    return Command(
        name,
        "ptnsbc_nodes.bridge_node",
        tuple(arguments),
        uav=uav,
        managed=f"/uav{uav}/bridge",
        ends=True,
    )


def _recorder(options: FleetOptions, bag: Path, scenario_file: Path) -> Command:
    arguments = ["--bag", str(bag), "--uavs", *map(str, options.scenario.uav_ids)]
    arguments += ["--attach", f"scenario.yaml={scenario_file}"]
    for key, value in _meta(options).items():
        arguments += ["--meta", f"{key}={value}"]
    if options.lockstep:
        arguments.append("--lockstep")
    if options.scenario.imperfect:
        arguments.append("--truth")
    if options.backend == "mavlink":
        arguments += ["--draw", str(scenario_file), "--punctual"]
    if options.overwrite:
        arguments.append("--overwrite")
    return Command(RECORDER, "ptnsbc_nodes.recorder", tuple(arguments))


def _meta(options: FleetOptions) -> Mapping[str, str]:
    own = {
        "mode": "lockstep" if options.lockstep else "realtime",
        "scenario": options.scenario.name,
    }
    return own | provenance() | dict(options.meta)
