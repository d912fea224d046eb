"""Process of one UAV: `python -m ptnsbc_nodes.uav.main --scenario FILE --uav N [--lockstep]`."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence

from ptnsbc_nodes.runtime.signals import exit_on_signal


def main(argv: Sequence[str] | None = None) -> int:
    """Fly one UAV until SIGINT or SIGTERM."""
    exit_on_signal()
    from ptnsbc_nodes.runtime.process import Arguments, run

    parser = Arguments("uav", "Controller of one UAV of a formation", scenario=False)
    parser.add_argument("--uav", type=int, metavar="N", help="id of this UAV")
    parser.add_argument("--managed", action="store_true", help="wait to be configured")
    return run(parser, argv, _fly)


def _fly(arguments: argparse.Namespace, argv: list[str]) -> int:
    from ptnsbc_nodes.comm.graph import CommunicationGraph
    from ptnsbc_nodes.runtime import environment, parameters
    from ptnsbc_nodes.runtime import process as processes
    from ptnsbc_nodes.runtime.lifecycle_node import ManagedNode
    from ptnsbc_nodes.runtime.warmup import load_agent
    from ptnsbc_nodes.uav.node import UavNode

    lifetime = processes.ProcessLifetime()
    given = parameters.overrides(
        {
            "scenario": arguments.scenario,
            "uav": arguments.uav,
            "lockstep": arguments.lockstep,
            "recorded": arguments.recorded,
            "bridged": arguments.bridged,
        }
    )
    fixed = (*parameters.SCENARIO, parameters.UAV, parameters.BRIDGED, parameters.AUTOSTART)
    namespace = processes.namespace_of(arguments.uav)
    with processes.parameter_node("controller", namespace, argv, given, ManagedNode) as node:
        settings = parameters.NodeParameters(node, fixed)
        settings.declare_scenario(node.fixed)
        load_agent(settings.scenario, settings.uav)
        if settings.options.lockstep:
            environment.prefer_throughput()
        elif settings.options.bridged:
            environment.prefer_punctuality(flies=True)

        def configure() -> UavNode:
            graph = CommunicationGraph(settings.scenario, settings.options)
            # A launcher ends its processes in order; one that was started by hand would outlive the flight.
            watched = environment.PARENT in os.environ
            on_abandoned = (lambda: None) if watched else lifetime.end
            return UavNode(node, settings.scenario, settings.uav, graph, on_abandoned)

        node.assign(configure, lifetime.end)
        autostart = settings["autostart"] and not arguments.managed
        return processes.serve_managed(node, lifetime, autostart=autostart)


if __name__ == "__main__":
    raise SystemExit(main())
