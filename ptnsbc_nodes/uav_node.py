"""Process of one UAV: `python -m ptnsbc_nodes.uav_node --scenario FILE --uav N [--lockstep]`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from ptnsbc_nodes import environment
from ptnsbc_nodes.edges import Edges
from ptnsbc_nodes.process import Arguments, Lifetime, flight_options, ros_node, run
from ptnsbc_nodes.uav import Uav
from ptnsbc_nodes.warmup import load_agent
from ptnsbc_sim.scenario import load_scenario


def main(argv: Sequence[str] | None = None) -> int:
    """Fly one UAV until SIGINT or SIGTERM."""
    parser = Arguments("uav_node", "Controller of one UAV of a formation")
    parser.add_argument("--uav", required=True, type=int, metavar="N", help="id of this UAV")
    return run(parser, argv, _fly)


def _fly(arguments: argparse.Namespace, argv: list[str]) -> int:
    lifetime = Lifetime()
    scenario = load_scenario(arguments.scenario)
    if arguments.bridged:
        scenario = scenario.bridged()
    scenario.uav(arguments.uav)  # refuses an id that is not in the file
    load_agent(scenario, arguments.uav)
    if arguments.lockstep:
        environment.prefer_throughput()
    elif arguments.bridged:
        environment.prefer_punctuality(flies=True)
    with ros_node("controller", f"/uav{arguments.uav}", argv) as node:
        uav = Uav(node, scenario, arguments.uav, Edges(scenario, flight_options(arguments)))
        lifetime.serve(node, uav.endpoints)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
