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

if TYPE_CHECKING:
    from ptnsbc_nodes.fleet.fleet_node import LauncherNode
    from ptnsbc_nodes.fleet.process_list import FleetOptions

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
    from ptnsbc_nodes.fleet.fleet_node import LauncherNode
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
            node = LauncherNode(domain, ros_arguments=argv[1:], seal=seal_of(scenario))
        with node:
            if arguments.manage:
                for i in scenario.uav_ids:
                    node.lifecycle.manage(f"uav{i}", f"/uav{i}/controller")
                    if arguments.bridged:
                        node.lifecycle.manage(f"bridge{i}", f"/uav{i}/bridge")
            _start(node, options, stop)
            if arguments.bridged and not stop.came:
                _fly_and_land(node, options, stop)
    return 0


def _start(node: LauncherNode, options: FleetOptions, stop: StopRequest) -> None:
    """Wait until all are ready, and start; return as well when a signal has come."""
    from ptnsbc_nodes.comm.topics import RECORDER
    from ptnsbc_nodes.fleet.process_list import names

    awaited = [name for name in names(options.scenario, options.backend) if name != RECORDER]
    if options.starts_by_clock and options.backend == "mavlink":
        node.leader.listen_for_start()
    began_s = reported_s = time.monotonic()
    refusal: str | None = "/formation/start was not called"
    while not stop.came:
        node.spin(_LOOK_S)
        waiting = node.status.missing(awaited)
        if not waiting:
            refusal = node.leader.start(patience_s=2.0)
            if refusal is None:
                node.status.mute()
                _say("started")
                return
        lines = [f"{name} waits for {what}" for name, what in waiting.items()] or [str(refusal)]
        if node.lifecycle.refused:
            raise CoordinatorError(f"{', '.join(node.lifecycle.refused)} refused to be activated")
        if time.monotonic() - began_s > options.patience_s:
            raise CoordinatorError(f"not ready in time: {'; '.join(lines)}")
        if time.monotonic() - reported_s > _REPORT_S:
            reported_s = time.monotonic()
            _say("; ".join(lines))


def _fly_and_land(node: LauncherNode, options: FleetOptions, stop: StopRequest) -> None:
    """Land real vehicles when the time is over; at a signal their bridges land them without being told."""
    from ptnsbc_nodes.fleet.supervisor import call_down

    over_s = time.monotonic() + options.patience_s
    while options.starts_by_clock and not (node.leader.begun or stop.came):
        node.spin(_LOOK_S)
        if time.monotonic() > over_s:
            raise CoordinatorError("the leader does not tell when the mission begins")
    over_s = time.monotonic() + node.leader.begins_in_s() + options.scenario.timing.duration_s
    while not stop.came and time.monotonic() < over_s:
        node.spin(_LOOK_S)
    if not stop.came:
        call_down(node, "land", _say)


def _say(line: str) -> None:
    print(f"coordinator: {line}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
