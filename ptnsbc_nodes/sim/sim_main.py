"""Process of the vehicles: `python -m ptnsbc_nodes.sim.sim_main --scenario FILE [--lockstep]`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from ptnsbc_nodes.runtime.signals import exit_on_signal


def main(argv: Sequence[str] | None = None) -> int:
    """Simulate until the flight is over, SIGINT or SIGTERM."""
    exit_on_signal()
    from ptnsbc_nodes.runtime.node_process import Arguments, run

    parser = Arguments("sim", "Simulated vehicles of a formation")
    parser.add_argument("--duration", type=float, metavar="S", help="instead of the scenario's")
    return run(parser, argv, _simulate)


def _simulate(arguments: argparse.Namespace, argv: list[str]) -> int:
    from ptnsbc_nodes.comm.graph import CommunicationGraph
    from ptnsbc_nodes.runtime import environment
    from ptnsbc_nodes.runtime.node_parameters import SIM_TIME, NodeParameterError
    from ptnsbc_nodes.runtime.node_process import (
        ProcessLifetime,
        flown,
        options_of,
        ros_context,
        ros_node,
    )
    from ptnsbc_nodes.runtime.warmup import load_world
    from ptnsbc_nodes.sim.sim_node import sim_node

    lifetime = ProcessLifetime()
    scenario = flown(arguments, {"timing.duration_s": arguments.duration})
    options = options_of(scenario, lockstep=arguments.lockstep, recorded=arguments.recorded)
    with ros_context(argv), ros_node("sim", "", scenario) as node:
        if node.get_parameter(SIM_TIME).value:
            raise NodeParameterError(
                f"parameter {SIM_TIME}: true: expected false, because the sim publishes the time"
            )
        load_world(scenario)
        if options.lockstep:
            environment.prefer_throughput()
        else:
            # The world is never late. Behind on full cores, it makes all odometry stale at once.
            environment.prefer_punctuality()
        graph = CommunicationGraph(scenario, options)
        sim = sim_node(node, scenario, graph, lifetime.end)
        lifetime.serve([node], lambda: [sim.endpoints], sim.rest_s)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
