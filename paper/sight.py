"""`python -m paper.sight`: how fast a formation may meet an obstacle that comes into sight late, for `docs/shares.md`.

The formation of `paper_5_free` flies behind a leader on a line, past one sphere that comes into sight of its sensors.
A speed counts if no UAV is deeper in the sphere than the margin around it, wherever its centre is beside the line.
"""

from __future__ import annotations

import json
import math
import sys
from itertools import takewhile
from typing import Any

import numpy as np

from docs.make.shares import SIGHT
from paper.experiment_result import rounded
from paper.report import commit
from ptnsbc_io.files import replacing
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.constants import clearance_config, sight_speed
from ptnsbc_sim.swarm import fly

KEEP_OUTS_M = (0.5, 1.0, 1.5, 2.0, 2.5)
SPEEDS_M_S = np.arange(1.0, 9.0, 0.25).tolist()
ASIDE = (-0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9)
"""Of the centre from the leader's line, in keep-outs, to the side and in height."""
MEETS_S = 12.0


def room_m(speed_m_s: float, keep_out_m: float, aside_m: tuple[float, float]) -> float:
    """The least distance [m] from the sphere that the leader meets after `MEETS_S`; below zero inside."""
    place = [speed_m_s * MEETS_S, aside_m[0], 10.0 + aside_m[1]]
    line = {"kind": "line", "position_m": [0, 0, 10], "velocity_m_s": [speed_m_s, 0, 0]}
    changes: dict[str, Any] = {
        "timing.duration_s": MEETS_S + 2.0,
        "leader.trajectory": line,
        "world.obstacles": [{"name": "rock", "position_m": place, "keep_out_m": keep_out_m}],
    }
    flown = fly(load_scenario("paper_5_free", changes))
    away = np.linalg.norm(flown.track.odometry[:, :, :3] - place, axis=2)
    return float(away.min() - keep_out_m)


def least_room_m(speed_m_s: float, keep_out_m: float) -> float:
    """The least over all places of the sphere."""
    asides = [keep_out_m * share for share in ASIDE]
    places = [*((y, 0.0) for y in asides), *((0.0, z) for z in asides if z)]
    return min(room_m(speed_m_s, keep_out_m, place) for place in places)


def row(keep_out_m: float) -> dict[str, float]:
    """Speeds [m/s] from which a UAV stops, that was flown, with which one can evade; least room [m] flown."""
    scenario = load_scenario("paper_5_free")
    rooms = ((speed, least_room_m(speed, keep_out_m)) for speed in SPEEDS_M_S)
    flown = list(takewhile(lambda one: one[1] > -scenario.gains.clearance.margin_m, rooms))
    wait_s = 1.0 / scenario.sensor.rate_hz + 1.0 / scenario.timing.control_hz
    evading_s = wait_s + math.sqrt(2.0 * keep_out_m / scenario.gains.filter.max_acceleration_m_s2)
    return {
        "keep_out_m": keep_out_m,
        "stops_m_s": sight_speed(clearance_config(scenario, 1), keep_out_m),
        "flown_m_s": flown[-1][0],
        "room_m": min(room for _, room in flown),
        "evades_m_s": scenario.sensor.range_m / evading_s,
    }


def main() -> int:
    """Fly all, write the figures, print them."""
    rows = [row(keep_out_m) for keep_out_m in KEEP_OUTS_M]
    about = {"commit": commit(("ptnsbc_core", "ptnsbc_sim", "scenarios")), "rows": rows}
    with replacing(SIGHT) as part:
        part.write_text(json.dumps(rounded(about), indent=1) + "\n", encoding="utf-8")
    print(SIGHT.read_text(encoding="utf-8"), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
