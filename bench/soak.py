"""A fleet of twenty UAVs among faults that a seed draws: who dies, who comes too near, who grows?

`python -m bench.soak [--lockstep] [--hz 50] [--duration 600] [--faults 60] [--uavs 20] [--seed 1]`. Messages are
silenced, lost, late and no numbers, positions jump by some centimetres; in real time processes also freeze and start
again. No process is killed for good: that is `bench.signals`.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.processes import Sampler
from bench.scenarios import grid
from bench.session import Machine, own_domain, print_progress
from ptnsbc_nodes.fleet.fleet import FleetOptions, run_fleet
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_tools.library.bags import repair
from ptnsbc_tools.reading.bag_reader import read_recording

_FORMED_S = 12.0  # faults begin when the formation stands
_LAST_S = 4.0  # no fault begins so late
_SETTLE_S = 60.0  # memory is compared with that after the first minute, or after a quarter of a shorter flight
_END_S = 5.0  # so long before its end no process of a flight ends
_PATIENCE_S = 600.0
_MOST_GROWTH = 0.01  # share of the memory


def drawn(scenario: Scenario, count: int, seed: int, *, lockstep: bool) -> list[dict[str, Any]]:
    """So many faults of followers, by the seed."""
    chance = random.Random(seed)
    kinds = ["silence", "loss", "delay", "nan", "jump"]
    kinds += [] if lockstep else ["freeze", "restart"]
    amounts: dict[str, dict[str, Any]] = {
        "loss": {"share": 0.3},
        "delay": {"delay_s": 0.1},
        "jump": {"offset_m": [0.05, -0.05, 0.03]},
    }
    found = []
    for _ in range(count):
        kind = chance.choice(kinds)
        at_s = round(chance.uniform(_FORMED_S, scenario.timing.duration_s - _LAST_S), 2)
        fault = {"kind": kind, "uav": chance.choice(scenario.followers), "at_s": at_s}
        if kind != "restart":
            fault["duration_s"] = round(chance.uniform(0.3, 2.5), 2)
        found.append(fault | amounts.get(kind, {}))
    return sorted(found, key=lambda one: float(one["at_s"]))


def soak(
    uavs: int, duration_s: float, faults: int, seed: int, hz: int, *, lockstep: bool
) -> dict[str, Any]:
    """Fly at `hz` control periods per second, and report."""
    scenario = grid(uavs, hz, duration_s)
    scenario = scenario.with_({"faults": drawn(scenario, faults, seed, lockstep=lockstep)})
    settle_s = min(_SETTLE_S, 0.25 * duration_s)
    machine = Machine()
    with tempfile.TemporaryDirectory(prefix="soak-") as name, own_domain(), Sampler() as sampler:
        folder = Path(name)

        def progress(line: str) -> None:
            print_progress(line)
            if line.endswith("started"):
                sampler.begin()

        options = FleetOptions(
            scenario,
            lockstep=lockstep,
            bag=folder / "bag",
            log_dir=folder / "logs",
            ready_timeout_s=_PATIENCE_S,
        )
        flown = run_fleet(options, progress)
        if not (folder / "bag").exists():  # its recorder died: what it wrote is judged
            repair(folder / "bag.part", folder / "bag")
        recording = read_recording(folder / "bag")
        verdict = verdict_on(recording)
    closest = min(verdict.separations, key=lambda one: one.distance_m - one.keep_out_m)
    # A fast lock-step is over before that.
    grown = sampler.growth(settle_s, min(duration_s, flown.flight_s - _END_S))
    return {
        "uavs": uavs,
        "duration_s": duration_s,
        "mode": f"{hz} Hz in {'lock-step' if lockstep else 'real time'}",
        "seed": seed,
        "faults": len(scenario.faults),
        "wall_s": round(flown.flight_s, 1),
        "died_unasked": list(flown.died),
        "exit_code": flown.exit_code,
        "recorder_lost": flown.recorded.get("lost"),
        "keep_outs_entered": sum(pair.entered for pair in verdict.separations),
        "closest_margin_m": round(closest.distance_m - closest.keep_out_m, 3),
        "closest": f"{closest.first} and {closest.second} at {closest.at_s:.2f} s",
        "memory_growth": {role: round(share, 4) for role, share in grown.items()},
        "missed_ticks": verdict.missed_ticks,
        "machine": machine.facts(),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 1 when anything is not as wanted.

    A process died unasked or grew by 1 %, a keep-out was entered, or a message did not reach the recorder.
    """
    parser = argparse.ArgumentParser(prog="python -m bench.soak", description=__doc__)
    parser.add_argument("--uavs", type=int, default=20)
    parser.add_argument("--duration", dest="duration_s", type=float, default=600.0, metavar="S")
    parser.add_argument("--faults", type=int, default=60, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--lockstep", action="store_true")
    parser.add_argument("--hz", type=int, default=50, help="control periods per second")
    options = parser.parse_args(arguments)
    found = soak(**vars(options))
    print(json.dumps(found, indent=1, default=str))
    bad = ("died_unasked", "keep_outs_entered", "recorder_lost")
    grown = max(found["memory_growth"].values(), default=0.0)
    return int(any(found[one] for one in bad) or grown >= _MOST_GROWTH)


if __name__ == "__main__":
    sys.exit(main())
