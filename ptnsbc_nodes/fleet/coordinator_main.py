"""Process of the coordinator: takes the nodes of a flight to active and starts it, for launch files.

`python -m ptnsbc_nodes.fleet.coordinator_main --scenario FILE [--manage] [--bridged]`
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.signals import StopRequest, exit_on_signal
from ptnsbc_sim.scenario.mission.legs import starts_by_clock

if TYPE_CHECKING:
    from ptnsbc_nodes.fleet.coordinator_node import Coordinator
    from ptnsbc_sim.scenario import Scenario

_LOOK_S = 0.05
_REPORT_S = 5.0


class CoordinatorError(PtnsbcError):
    """A flight that could not be started."""


def main(argv: Sequence[str] | None = None) -> int:
    """Start one flight; real vehicles are told to land when its time is over."""
    exit_on_signal()
    from ptnsbc_nodes.runtime.node_process import Arguments, run

    parser = Arguments("coordinator", "Starts a flight when all its nodes are ready")
    parser.add_argument("--manage", action="store_true", help="configure and activate them first")
    parser.add_argument(
        "--patience", type=float, metavar="S", help="give up after so long; 30 s + 5 s per UAV"
    )
    return run(parser, argv, _serve)


def _serve(arguments: argparse.Namespace, argv: list[str]) -> int:
    from ptnsbc_nodes.comm.seal import seal_of
    from ptnsbc_nodes.fleet.coordinator_node import Coordinator
    from ptnsbc_nodes.fleet.process_list import FleetOptions
    from ptnsbc_nodes.runtime import environment
    from ptnsbc_nodes.runtime.node_process import ros_errors
    from ptnsbc_nodes.security.middleware import check_enforced
    from ptnsbc_sim.scenario import load_scenario

    scenario = load_scenario(arguments.scenario)
    check_enforced(scenario)
    options = FleetOptions(
        scenario,
        backend="mavlink" if arguments.bridged else "sim",
        ready_timeout_s=arguments.patience,
    )
    with StopRequest() as stop:
        with ros_errors():
            domain = environment.named_domain()
            coordinator = Coordinator(domain, ros_arguments=argv[1:], seal=seal_of(scenario))
        with coordinator:
            _fly(coordinator, arguments, options.patience_s, scenario, stop)
    return 0


def _fly(
    coordinator: Coordinator,
    arguments: argparse.Namespace,
    patience_s: float,
    scenario: Scenario,
    stop: StopRequest,
) -> None:
    if arguments.manage:
        for i in scenario.uav_ids:
            coordinator.manage(f"uav{i}", f"/uav{i}/controller")
            if arguments.bridged:
                coordinator.manage(f"bridge{i}", f"/uav{i}/bridge")
    uavs = [f"uav{i}" for i in scenario.uav_ids]
    vehicles = [f"bridge{i}" for i in scenario.uav_ids] if arguments.bridged else ["sim"]
    by_clock = arguments.bridged and starts_by_clock(scenario.mission)
    if by_clock:
        coordinator.listen_for_start()
    if _start(coordinator, [*uavs, *vehicles], patience_s, stop):
        _say("started")
        if arguments.bridged:
            if by_clock:
                _hear_begin(coordinator, patience_s, stop)
            _land(coordinator, coordinator.begins_in_s() + scenario.timing.duration_s, stop)


def _start(
    coordinator: Coordinator, names: Sequence[str], patience_s: float, stop: StopRequest
) -> bool:
    """Wait until all are ready, and start; False when a signal came first."""
    began = time.monotonic()
    told = began
    refusal: str | None = "/formation/start was not called"
    while not stop.came:
        coordinator.spin(_LOOK_S)
        waiting = coordinator.missing(names)
        if not waiting:
            refusal = coordinator.start(patience_s=2.0)
            if refusal is None:
                return True
        lines = [f"{name} waits for {what}" for name, what in waiting.items()] or [str(refusal)]
        if coordinator.refused:
            raise CoordinatorError(f"{', '.join(coordinator.refused)} refused to be activated")
        if time.monotonic() - began > patience_s:
            raise CoordinatorError(f"not ready in time: {'; '.join(lines)}")
        if time.monotonic() - told > _REPORT_S:
            told = time.monotonic()
            _say("; ".join(lines))
    return False


def _hear_begin(coordinator: Coordinator, patience_s: float, stop: StopRequest) -> None:
    over_s = time.monotonic() + patience_s
    while not (coordinator.begun or stop.came):
        coordinator.spin(_LOOK_S)
        if time.monotonic() > over_s:
            raise CoordinatorError("the leader does not tell when the mission begins")


def _land(coordinator: Coordinator, duration_s: float, stop: StopRequest) -> None:
    """Land real vehicles when the time is over; at a signal their bridges land them without being told."""
    from ptnsbc_nodes.fleet.emergency_stop import order_landing

    over_s = time.monotonic() + duration_s
    while not stop.came and time.monotonic() < over_s:
        coordinator.spin(_LOOK_S)
    if not stop.came:
        refusal = coordinator.call("land", patience_s=3.0)
        if refusal is not None:
            _say(f"{refusal}: every bridge is told to land by itself")
            for line in order_landing(coordinator):
                _say(line)


def _say(line: str) -> None:
    print(f"coordinator: {line}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
