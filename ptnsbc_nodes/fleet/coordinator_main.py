"""Process of the coordinator: starts a flight once all its processes are ready, for launch files.

`python -m ptnsbc_nodes.fleet.coordinator_main --scenario FILE [--bridged]`
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from ptnsbc_nodes.runtime.signals import StopRequest, exit_on_signal

_LOOK_S = 0.05


def main(argv: Sequence[str] | None = None) -> int:
    """Start one flight; real vehicles are told to land when its time is over."""
    exit_on_signal()
    from ptnsbc_nodes.runtime.node_process import Arguments, run

    parser = Arguments("coordinator", "Starts a flight when all its nodes are ready")
    parser.add_argument(
        "--patience", type=float, metavar="S", help="give up after so long; 30 s + 5 s per UAV"
    )
    return run(parser, argv, _serve)


def _serve(arguments: argparse.Namespace, argv: list[str]) -> int:
    from ptnsbc_nodes.comm.topics import RECORDER
    from ptnsbc_nodes.fleet.child_process import Crew, FleetOptions
    from ptnsbc_nodes.fleet.fleet_node import LauncherNode
    from ptnsbc_nodes.fleet.supervisor import call_down
    from ptnsbc_nodes.fleet.takeoff import Launch, TakeOff
    from ptnsbc_nodes.runtime import environment
    from ptnsbc_nodes.runtime.node_process import flown, options_of

    scenario = flown(arguments)
    seal = options_of(scenario).seal
    backend: Literal["sim", "mavlink"] = "mavlink" if arguments.bridged else "sim"
    options = FleetOptions(scenario, backend=backend, ready_timeout_s=arguments.patience)
    deadline = time.monotonic() + options.patience_s
    # Others have started all processes; this one leads, as a computer with the recorder does.
    options = replace(options, only=frozenset({RECORDER}))
    with StopRequest() as stop:
        domain = environment.named_domain()
        with LauncherNode(domain, ros_arguments=argv[1:], seal=seal) as node:
            crew = Crew({}, Path())
            TakeOff(Launch(options, crew, node, stop, _say)).run((), deadline)
            if arguments.bridged:
                over_s = time.monotonic() + node.leader.begins_in_s() + scenario.timing.duration_s
                while not stop.came and time.monotonic() < over_s:
                    node.spin(_LOOK_S)
                if not stop.came:  # at a signal the bridges land their vehicles without being told
                    call_down(node, "land", _say)
    return 0


def _say(line: str) -> None:
    print(f"coordinator: {line}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
