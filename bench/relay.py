"""`relay` as real processes in real time: one killed with SIGKILL and started again, the leader killed for good.

`python -m bench.relay [--runs 20] [--out DIR]` flies it so often and counts the flights whose verdict is *met*; DIR
keeps the bags and logs of the others. A flight that is not met while other programs had the processors is *not judged*,
by the rule of the tests in real time (`tests/support/real_time.py`).
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from bench.session import own_domain, print_progress
from ptnsbc_nodes.fleet.fleet import run_fleet
from ptnsbc_nodes.fleet.process_list import FleetOptions
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.deadline import MET
from ptnsbc_tools.reading.bag_reader import read_recording

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from real_time import (  # type: ignore[import-not-found]
    NOT_JUDGED,
    Probe,
    evidence,
    taken,
    usage,
)

NOT_MET = "not met"


def flown(number: int, folder: Path, probe: Probe) -> str:
    """Fly it once, and tell its verdict, why a UAV has not met it, and what the machine left to it."""
    bag = folder / f"bag_{number}"
    options = FleetOptions(load_scenario("relay"), bag=bag, log_dir=folder)
    probe.ask()
    before = usage()
    with own_domain():
        if run_fleet(options, print_progress).interrupted:
            raise KeyboardInterrupt
    delays, used = probe.ask(), usage().minus(before)
    verdict = verdict_on(read_recording(bag))
    for one in verdict.uavs:
        print(f"{number}: UAV {one.uav} {one.verdict} {one.reason or one.excuse}")
    found = MET if verdict.verdict == MET else NOT_JUDGED if taken(delays, used) else NOT_MET
    rmse_m = max(one.rmse_after_m for one in verdict.uavs if one.rmse_after_m is not None)
    print(
        f"{number}: {found}, verdict {verdict.verdict}, RMSE at most {rmse_m * 1e3:.1f} mm outside encounters; "
        f"{evidence(delays, used)}",
        flush=True,
    )
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; exit code 1 when a flight is not met."""
    parser = argparse.ArgumentParser(prog="bench.relay", description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="keeps the flights that are not met"
    )
    arguments = parser.parse_args(argv)
    runs, count = arguments.runs, Counter[str]()
    with closing(Probe()) as probe:
        for number in range(1, runs + 1):
            with tempfile.TemporaryDirectory() as folder:
                found = flown(number, Path(folder), probe)
                if found != MET and arguments.out is not None:
                    shutil.copytree(folder, arguments.out / f"flight_{number}")
            count[found] += 1
    print(", ".join(f"{kind}: {count[kind]} of {runs}" for kind in (MET, NOT_MET, NOT_JUDGED)))
    return 0 if count[MET] == runs else 1


if __name__ == "__main__":
    sys.exit(main())
