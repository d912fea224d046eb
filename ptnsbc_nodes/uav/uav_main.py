"""Process of one UAV, or of several: `python -m ptnsbc_nodes.uav.uav_main --scenario FILE --uav N... [--lockstep]`."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from contextlib import ExitStack

from ptnsbc_nodes.runtime.signals import exit_on_signal


def main(argv: Sequence[str] | None = None) -> int:
    """Fly until SIGINT or SIGTERM."""
    exit_on_signal()
    from ptnsbc_nodes.runtime.node_process import Arguments, run

    parser = Arguments("uav", "Controller of one UAV of a formation, or of several")
    parser.add_argument(
        "--uav",
        type=int,
        nargs="+",
        metavar="N",
        required=True,
        help="ids of the UAVs of this process, one or several",
    )
    parser.add_argument(
        "--fleet",
        default="",
        metavar="NAMESPACE",
        help="namespace of the fleet, for a process of several UAVs",
    )
    return run(parser, argv, _fly)


def _fly(arguments: argparse.Namespace, argv: list[str]) -> int:
    from ptnsbc_nodes.comm.graph import CommunicationGraph
    from ptnsbc_nodes.runtime import environment
    from ptnsbc_nodes.runtime import node_process as processes
    from ptnsbc_nodes.runtime.launcher import PARENT
    from ptnsbc_nodes.runtime.warmup import load_agent
    from ptnsbc_nodes.uav.uav_node import UavNode

    lifetime = processes.ProcessLifetime()
    # A launcher ends its processes in order; one that was started by hand would outlive the flight.
    on_abandoned = (lambda: None) if PARENT in os.environ else lifetime.end
    scenario = processes.flown(arguments)
    how = {name: getattr(arguments, name) for name in ("lockstep", "recorded", "bridged")}
    options = processes.options_of(scenario, **how)
    graph = CommunicationGraph(scenario, options)
    with ExitStack() as stack:
        stack.enter_context(processes.ros_context(argv))
        uavs: list[UavNode] = []
        for uav in arguments.uav:
            namespace = f"{arguments.fleet}/uav{uav}"
            node = stack.enter_context(processes.ros_node("controller", namespace, scenario))
            load_agent(scenario, scenario.uav(uav).id)
            uavs.append(UavNode(node, scenario, uav, graph, on_abandoned))
        if options.lockstep:
            environment.prefer_throughput()
        elif options.bridged:
            environment.prefer_punctuality()
        for one in uavs:
            one.start()
        lifetime.serve([one.node for one in uavs], lambda: [one.endpoints for one in uavs])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
