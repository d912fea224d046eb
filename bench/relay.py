"""`relay` as real processes in real time: one killed with SIGKILL and started again, the leader killed for good.

`python -m bench.relay [--runs 20]` flies it so often and counts the flights whose verdict is *met*.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from bench.session import own_domain, print_progress
from ptnsbc_nodes.fleet.fleet import run_fleet
from ptnsbc_nodes.fleet.process_list import FleetOptions
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.deadline import MET
from ptnsbc_tools.reading.bag_reader import read_recording


def flown(number: int, folder: Path) -> bool:
    """Fly it once, and tell its verdict and why a UAV has not met it."""
    bag = folder / f"bag_{number}"
    options = FleetOptions(load_scenario("relay"), bag=bag, log_dir=folder)
    with own_domain():
        run_fleet(options, print_progress)
    verdict = verdict_on(read_recording(bag))
    for one in verdict.uavs:
        print(f"{number}: UAV {one.uav} {one.verdict} {one.reason or one.excuse}")
    print(f"{number}: {verdict.verdict}", flush=True)
    return verdict.verdict == MET


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; exit code 1 when a flight is not met."""
    parser = argparse.ArgumentParser(prog="bench.relay", description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    runs = parser.parse_args(argv).runs
    with tempfile.TemporaryDirectory() as folder:
        met = sum(flown(number, Path(folder)) for number in range(1, runs + 1))
    print(f"met: {met} of {runs}")
    return 0 if met == runs else 1


if __name__ == "__main__":
    sys.exit(main())
