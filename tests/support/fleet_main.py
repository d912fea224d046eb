"""The launcher as a process, without the verdict of `ptnsbc fleet`.

`python -m tests.support.fleet_main --scenario paper_5 --lockstep --bag DIR`, in the folder of the repository.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from ptnsbc_nodes.runtime.signals import exit_on_signal

_INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Fly until the scenario's duration is over, or a signal comes."""
    exit_on_signal(_INTERRUPTED)
    from ptnsbc_nodes.runtime.node_process import Arguments, run

    parser = Arguments("fleet", "A formation on this host, one process per UAV")
    parser.add_argument("--duration", type=float, metavar="S", help="instead of the scenario's")
    parser.add_argument("--bag", type=Path, help="record into this folder")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing bag")
    parser.add_argument(
        "--processes",
        type=int,
        metavar="K",
        help="fly all UAVs in K processes, not in one for each",
    )
    parser.add_argument("--wait", action="store_true", help="leave the start to an operator")
    parser.add_argument("--backend", choices=("sim", "mavlink", "ros"), default="sim")
    parser.add_argument("--allow-arming", action="store_true", help="of real vehicles")
    parser.add_argument("--log-dir", type=Path, help="where each process writes its log")
    return run(parser, argv, _fly)


def _fly(arguments: argparse.Namespace, _argv: list[str]) -> int:
    from ptnsbc_nodes.fleet.fleet import FleetOptions, run_fleet
    from ptnsbc_nodes.runtime.node_process import flown

    arguments.bridged = arguments.backend != "sim"
    autopilot = "ros" if arguments.backend == "ros" else None
    keys = {"timing.duration_s": arguments.duration, "mavlink.autopilot": autopilot}
    scenario = flown(arguments, keys)
    names = {field.name for field in fields(FleetOptions)} & vars(arguments).keys() - {"scenario"}
    options = FleetOptions(scenario, **{name: getattr(arguments, name) for name in names})
    result = run_fleet(options, _say)
    end = "interrupted" if result.interrupted else "landed"
    gone = ", ".join(filter(None, (result.losses, *result.killed)))
    lost = f", ended early or with a fault: {gone}" if gone else ""
    recorded = result.recorded
    kept = f", {recorded.get('messages', 0)} messages in {result.bag}" if result.bag else ""
    kept += "".join(f", {recorded[what]} {what}" for what in ("late", "lost") if recorded.get(what))
    kept += f", {recorded['refused']}" if recorded.get("refused") else ""
    seconds = f"{result.flight_s:.1f} s (start-up {result.startup_s:.1f} s)"
    _say(f"{end} after {seconds}{lost}{kept}")
    return result.exit_code


def _say(line: str) -> None:
    print(f"fleet: {line}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
