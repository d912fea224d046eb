"""One process of the reference: `python -m bench.pingpong --role uav --scenario FILE --uav N`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from bench.pingpong.endpoints import RawEndpoints, TypedEndpoints
from bench.pingpong.sim import BareRecorder, BareSim
from bench.pingpong.uav import BareUav
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.process import Arguments, ProcessLifetime, ros_node, run
from ptnsbc_sim.scenario import load_scenario

ROLES = ("uav", "sim", "recorder")


def main(argv: Sequence[str] | None = None) -> int:
    """One process of the reference fleet; its last line is what it counted, as JSON."""
    parser = Arguments("pingpong", "A fleet without laws")
    parser.add_argument("--role", choices=ROLES, required=True)
    parser.add_argument("--uav", type=int, default=0)
    parser.add_argument("--go", type=Path, help="the sim begins when this file exists")
    parser.add_argument("--typed", action="store_true", help="messages are objects, not bytes")
    return run(parser, argv, _serve)


def _serve(arguments: argparse.Namespace, argv: list[str]) -> int:
    lifetime, scenario = ProcessLifetime(), load_scenario(arguments.scenario)
    options = FlightOptions(arguments.lockstep, arguments.recorded, arguments.bridged)
    edges = CommunicationGraph(scenario, options)
    name = f"{arguments.role}{arguments.uav or ''}"
    if options.lockstep and arguments.role != "recorder":  # as the processes of a fleet
        environment.prefer_throughput()
    elif not options.lockstep and environment.has_room(len(scenario.uav_ids), scenario.control_hz):
        environment.prefer_punctuality(flies=arguments.role != "recorder")
    with ros_node(name, f"uav{arguments.uav}" if arguments.uav else "", argv) as node:
        kind = TypedEndpoints if arguments.typed else RawEndpoints
        endpoints = kind(node, options.lockstep)
        if arguments.role == "uav":
            uav = BareUav(node, endpoints, scenario, arguments.uav, edges)
            lifetime.serve(node, endpoints)
            counted = {"ticks": float(uav.ticks), "missed": float(uav.pace.missed)}
        elif arguments.role == "sim":
            sim = BareSim(node, endpoints, scenario, edges, arguments.go, lifetime.end)
            lifetime.serve(node, endpoints)
            counted = {
                "ticks": float(sim.ticks),
                "missed": float(sim.pace.missed),
                "seconds": (sim.ended_ns - sim.began_ns) * 1e-9,
                "p50_ms": 1e3 * sim.latency.percentile_s(50),
                "p99_ms": 1e3 * sim.latency.percentile_s(99),
            }
        else:
            recorder = BareRecorder(node, scenario, options.lockstep)
            lifetime.serve(node, recorder.endpoints)
            counted = {"received": float(recorder.received)}
    print(json.dumps(counted), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
