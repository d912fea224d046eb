"""Takes the nodes of a flight to active and starts it when all are ready: what `fleet` does, for launch files.

`python -m ptnsbc_nodes.fleet.coordinator_main --scenario FILE [--manage] [--bridged] [--lose NAME]`
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.fleet.coordinator_node import Coordinator
from ptnsbc_nodes.fleet.process_list import SIM, FleetOptions
from ptnsbc_nodes.runtime.process import Arguments, run
from ptnsbc_nodes.runtime.ros_args import ros_errors
from ptnsbc_nodes.runtime.signals import StopRequest
from ptnsbc_sim.scenario import Scenario, load_scenario

_LOOK_S = 0.05
_REPORT_S = 5.0


class CoordinatorError(PtnsbcError):
    """A flight that could not be started."""


def main(argv: Sequence[str] | None = None) -> int:
    """Start one flight; real vehicles are told to land when its time is over."""
    parser = Arguments("tower", "Starts a flight when all its nodes are ready")
    parser.add_argument("--manage", action="store_true", help="configure and activate them first")
    parser.add_argument(
        "--patience", type=float, metavar="S", help="give up after so long; 30 s + 5 s per UAV"
    )
    parser.add_argument(
        "--lose", metavar="NAME", help="instead, tell all that this process has ended, until Ctrl-C"
    )
    return run(parser, argv, _serve)


def _serve(arguments: argparse.Namespace, argv: list[str]) -> int:
    scenario = load_scenario(arguments.scenario)
    options = FleetOptions(
        scenario,
        backend="mavlink" if arguments.bridged else "sim",
        ready_timeout_s=arguments.patience,
    )
    name = f"lost_{arguments.lose}" if arguments.lose else "fleet"
    with ros_errors():
        tower = Coordinator(int(os.environ.get("ROS_DOMAIN_ID", "0")), name, argv[1:])
    with StopRequest() as stop, tower:
        if arguments.lose:
            return _mourn(tower, arguments.lose, stop)
        uavs = [f"uav{i}" for i in scenario.uav_ids]
        bridges = [f"bridge{i}" for i in scenario.uav_ids] if arguments.bridged else []
        if arguments.manage:
            _manage(tower, scenario, bridged=arguments.bridged)
        if not _start(tower, [*uavs, *(bridges or [SIM])], options.patience_s, stop):
            return 0
        _say("started")
        if bridges:
            _land(tower, scenario.duration_s, stop)
    return 0


def _manage(tower: Coordinator, scenario: Scenario, *, bridged: bool) -> None:
    for i in scenario.uav_ids:
        tower.manage(f"uav{i}", f"/uav{i}/controller")
        if bridged:
            tower.manage(f"bridge{i}", f"/uav{i}/bridge")


def _start(tower: Coordinator, names: Sequence[str], patience_s: float, stop: StopRequest) -> bool:
    """Wait until all are ready, and start; False when a signal came first."""
    began = told = time.monotonic()
    refusal: str | None = "/formation/start was not called"
    while not stop.came:
        tower.spin(_LOOK_S)
        waiting = tower.missing(names)
        if not waiting:
            refusal = tower.start(patience_s=2.0)
            if refusal is None:
                return True
        lines = [f"{name} waits for {what}" for name, what in waiting.items()] or [str(refusal)]
        if tower.refused:
            raise CoordinatorError(f"{', '.join(tower.refused)} refused to be activated")
        if time.monotonic() - began > patience_s:
            raise CoordinatorError(f"not ready in time: {'; '.join(lines)}")
        if time.monotonic() - told > _REPORT_S:
            told = time.monotonic()
            _say("; ".join(lines))
    return False


def _mourn(tower: Coordinator, name: str, stop: StopRequest) -> int:
    """Say who has ended, to those who come later too: nobody is to wait for it."""
    tower.lose(name)
    _say(f"{name} has ended: nobody waits for it")
    while not stop.came:
        tower.spin(_LOOK_S)
    return 0


def _land(tower: Coordinator, duration_s: float, stop: StopRequest) -> None:
    """Land real vehicles when the time is over; at a signal their bridges do by themselves."""
    over_s = time.monotonic() + duration_s
    while not stop.came and time.monotonic() < over_s:
        tower.spin(_LOOK_S)
    if not stop.came:
        refusal = tower.call("land", patience_s=3.0)
        if refusal is not None:
            _say(f"{refusal}: every bridge is told to land by itself")
            tower.emergency("land")


def _say(line: str) -> None:
    print(f"tower: {line}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
