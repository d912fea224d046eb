"""Process of the vehicles: `python -m ptnsbc_nodes.sim_node --scenario FILE [--lockstep]`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from ptnsbc_nodes import environment, topics
from ptnsbc_nodes.edges import Edges
from ptnsbc_nodes.process import Arguments, Lifetime, flight_options, ros_node, run
from ptnsbc_nodes.sim import Sim
from ptnsbc_nodes.warmup import load_world
from ptnsbc_sim.scenario import load_scenario


def main(argv: Sequence[str] | None = None) -> int:
    """Simulate until the flight is over, SIGINT or SIGTERM."""
    parser = Arguments("sim_node", "Simulated vehicles of a formation")
    parser.add_argument("--duration", type=float, metavar="S", help="instead of the scenario's")
    return run(parser, argv, _simulate)


def _simulate(arguments: argparse.Namespace, argv: list[str]) -> int:
    lifetime = Lifetime()
    overrides = {"timing.duration_s": arguments.duration}
    scenario = load_scenario(arguments.scenario, overrides)
    if not topics.tf_is_available():
        print("sim: no live /tf, tf2_msgs is not installed; bags have it", file=sys.stderr)
    load_world(scenario)
    if arguments.lockstep:
        environment.prefer_throughput()
    with ros_node("sim", "", argv) as node:
        sim = Sim(node, scenario, Edges(scenario, flight_options(arguments)), lifetime.end)
        lifetime.serve(node, sim.endpoints)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
