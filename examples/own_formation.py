"""Own formation: seven UAVs in a V, made in Python instead of a file, flown and drawn."""

import sys
from pathlib import Path

import numpy as np

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")

followers = range(2, 8)
side = {uav: -1 if uav % 2 == 0 else 1 for uav in followers}  # even ids on the left
arm = {uav: uav // 2 for uav in followers}  # 1, 1, 2, 2, 3, 3 places behind the leader
offsets = {uav: [-1.2 * arm[uav], 1.0 * side[uav] * arm[uav], 0.3 * arm[uav]] for uav in followers}
starts = {uav: [-1.5 * (uav - 1), 1.5 * (uav % 3 - 1), 0.0] for uav in range(1, 8)}

scenario = ptnsbc.load(
    {
        "extends": "paper_5_free",
        "name": "v_of_seven",
        "communication": {
            "tree": {uav: max(uav - 2, 1) for uav in followers},  # each follows the one ahead
            "leader_links": list(followers),
            "estimator_edges": [[2, 4], [4, 6], [3, 5], [5, 7]],
        },
        "formation": {"task": "relative_position", "offsets_m": offsets},
        "uavs": [{"id": uav, "position_m": np.round(at, 2)} for uav, at in starts.items()],
    }
)
ptnsbc.check(scenario, dry_runs=0).refuse()
flight = ptnsbc.fly(scenario)
print(flight.verdict.verdict, "by", max(one.settling_s for one in flight.verdict.uavs), "s")
print("picture:", flight.save_picture(OUT / "own_formation.png"))
