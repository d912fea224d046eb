"""Process of one UAV: `python -m ptnsbc_nodes.uav.main --scenario FILE --uav N [--lockstep]`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.lifecycle_node import ManagedNode
from ptnsbc_nodes.runtime.parameters import (
    AUTOSTART,
    BRIDGED,
    SCENARIO,
    UAV,
    NodeParameters,
    overrides,
)
from ptnsbc_nodes.runtime.process import (
    Arguments,
    ProcessLifetime,
    namespace_of,
    parameter_node,
    run,
    serve_managed,
)
from ptnsbc_nodes.runtime.warmup import load_agent
from ptnsbc_nodes.uav.node import UavNode

_FIXED = (*SCENARIO, UAV, BRIDGED, AUTOSTART)


def main(argv: Sequence[str] | None = None) -> int:
    """Fly one UAV until SIGINT or SIGTERM."""
    parser = Arguments("uav", "Controller of one UAV of a formation", scenario=False)
    parser.add_argument("--uav", type=int, metavar="N", help="id of this UAV")
    parser.add_argument("--managed", action="store_true", help="wait to be configured")
    return run(parser, argv, _fly)


def _fly(arguments: argparse.Namespace, argv: list[str]) -> int:
    lifetime = ProcessLifetime()
    given = overrides(
        {
            "scenario": arguments.scenario,
            "uav": arguments.uav,
            "lockstep": arguments.lockstep,
            "recorded": arguments.recorded,
            "bridged": arguments.bridged,
        }
    )
    namespace = namespace_of(arguments.uav)
    with parameter_node("controller", namespace, argv, given, ManagedNode) as node:
        told = NodeParameters(node, _FIXED)
        told.declare_scenario(may_change=lambda: node.state == "unconfigured")
        load_agent(told.scenario, told.uav)
        if told.options.lockstep:
            environment.prefer_throughput()
        elif told.options.bridged:
            environment.prefer_punctuality(flies=True)

        def configure() -> UavNode:
            return UavNode(
                node, told.scenario, told.uav, CommunicationGraph(told.scenario, told.options)
            )

        node.assign(configure, lifetime.end)
        return serve_managed(node, lifetime, autostart=told["autostart"] and not arguments.managed)


if __name__ == "__main__":
    raise SystemExit(main())
