"""Process of one UAV, or of several: `python -m ptnsbc_nodes.uav.uav_main --scenario FILE --uav N... [--lockstep]`."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING

from ptnsbc_nodes.runtime.signals import exit_on_signal

if TYPE_CHECKING:
    from ptnsbc_nodes.runtime.lifecycle_node import ManagedNode
    from ptnsbc_nodes.runtime.node_parameters import NodeParameters
    from ptnsbc_nodes.runtime.node_process import ProcessLifetime


def main(argv: Sequence[str] | None = None) -> int:
    """Fly until SIGINT or SIGTERM."""
    exit_on_signal()
    from ptnsbc_nodes.runtime.node_process import Arguments, run

    parser = Arguments("uav", "Controller of one UAV of a formation, or of several", scenario=False)
    parser.add_argument(
        "--uav",
        type=int,
        nargs="+",
        metavar="N",
        default=[None],
        help="ids of the UAVs of this process, one or several",
    )
    parser.add_argument(
        "--fleet",
        default="",
        metavar="NAMESPACE",
        help="namespace of the fleet, for a process of several UAVs",
    )
    parser.add_argument("--managed", action="store_true", help="wait to be configured")
    return run(parser, argv, _fly)


def _fly(arguments: argparse.Namespace, argv: list[str]) -> int:
    from ptnsbc_nodes.runtime import environment
    from ptnsbc_nodes.runtime import node_parameters as ros_parameters
    from ptnsbc_nodes.runtime import node_process as processes
    from ptnsbc_nodes.runtime.lifecycle_node import ManagedNode
    from ptnsbc_nodes.runtime.warmup import load_agent

    lifetime = processes.ProcessLifetime()
    with ExitStack() as stack:
        stack.enter_context(processes.ros_context(argv))
        nodes: list[ManagedNode] = []
        for uav in arguments.uav:
            given = {
                "scenario": arguments.scenario,
                "uav": uav,
                "lockstep": arguments.lockstep,
                "recorded": arguments.recorded,
                "bridged": arguments.bridged,
            }
            namespace = arguments.fleet + ("" if uav is None else f"/uav{uav}")
            overrides = ros_parameters.overrides(given)
            made = processes.ros_node(
                "controller", namespace, make=ManagedNode, parameters=overrides
            )
            node = stack.enter_context(made)
            fixed = (ros_parameters.UAV, ros_parameters.BRIDGED, ros_parameters.AUTOSTART)
            settings = ros_parameters.NodeParameters(node, (*ros_parameters.SCENARIO, *fixed))
            settings.declare_scenario(node.fixed)
            load_agent(settings.scenario, settings.uav)
            _assign(node, settings, lifetime)
            nodes.append(node)
        if settings.options.lockstep:
            environment.prefer_throughput()
        elif settings.options.bridged:
            environment.prefer_punctuality()
        autostart = settings["autostart"] and not arguments.managed
        return processes.serve_managed(nodes, lifetime, autostart=autostart)


def _assign(node: ManagedNode, settings: NodeParameters, lifetime: ProcessLifetime) -> None:
    """The work of the node of one UAV."""
    from ptnsbc_nodes.comm.graph import CommunicationGraph
    from ptnsbc_nodes.runtime.launcher import PARENT
    from ptnsbc_nodes.uav.uav_node import UavNode

    def configure() -> UavNode:
        graph = CommunicationGraph(settings.scenario, settings.options)
        # A launcher ends its processes in order; one that was started by hand would outlive the flight.
        watched = PARENT in os.environ
        on_abandoned = (lambda: None) if watched else lifetime.end
        return UavNode(node, settings.scenario, settings.uav, graph, on_abandoned)

    node.assign(configure, lifetime.end)


if __name__ == "__main__":
    raise SystemExit(main())
