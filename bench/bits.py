"""A fleet of processes in lock-step against one process: both fly a scenario alike, to the last bit.

`python -m bench.bits show_20` flies it as processes and headless, and compares every odometry, formation state, leader
estimate and wrench. `--bag BAG` compares a lock-step flight that is recorded.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.digests import ptnsbc
from ptnsbc_io.bag import read_bag
from ptnsbc_io.wire import decode_odometry, decode_wrench
from ptnsbc_sim.scenario import scenario_from_text
from ptnsbc_sim.swarm import fly


class Comparison(NamedTuple):
    """Messages of a fleet beside what the same flight has without processes."""

    uavs: int
    compared: int
    different: int


def compared(path: Path) -> Comparison:
    """Compare a recorded lock-step flight with the headless one of its scenario."""
    bag = read_bag(path)
    scenario = scenario_from_text((bag.attachment("scenario.yaml") or b"").decode())
    track = fly(scenario).track
    expected = {
        "odom": (decode_odometry, track.odometry),
        "formation_state": (decode_odometry, track.reported),
        "leader_estimate": (decode_odometry, track.estimate),
        "setpoint/wrench": (decode_wrench, track.wrench),
    }
    count = different = 0
    for row, uav in enumerate(scenario.uav_ids):
        for topic, (decode, values) in expected.items():
            for message in bag.messages([f"/uav{uav}/{topic}"]):
                stamp_ns, found = decode(message.data)
                wanted = np.ascontiguousarray(values[stamp_ns // scenario.dt_ns, row])
                count += 1
                different += found.tobytes() != wanted.tobytes()
    return Comparison(len(scenario.uav_ids), count, different)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the comparison; exit code 1 when a bit differs, or there is nothing to compare."""
    parser = argparse.ArgumentParser(prog="bench.bits", description=__doc__)
    parser.add_argument("scenario", nargs="?", default="show_20")
    parser.add_argument("--bag", type=Path, help="a recorded lock-step flight, instead of a flight")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        bag = options.bag
        if bag is None:
            bag = Path(name) / "bag"
            root = Path(__file__).resolve().parents[1]
            code = ptnsbc(root, "fleet", options.scenario, "--lockstep", bag=bag)
            if code:
                print(f"{options.scenario}: the fleet ended with exit code {code}", file=sys.stderr)
        found = compared(bag)
    print(f"{found.uavs} UAVs: {found.compared} messages, {found.different} different")
    return 0 if found.compared and not found.different else 1


if __name__ == "__main__":
    raise SystemExit(main())
