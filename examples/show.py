"""Show: all drones of a Skybrush file as a formation that changes its shape: show.py [FOLDER] [SHOW.skyc]."""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

import ptnsbc
from ptnsbc_core.curves.trajectory import reference
from ptnsbc_sim.scenario.mission.trajectories import trajectory_of

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")
SHOW = Path(sys.argv[2]) if sys.argv[2:] else Path(__file__).with_name("show.skyc")
FORMED_S, EVERY_S = 6.0, 5.0  # until the first shape is there; from one to the next
curves, drone = [], {"kind": "file", "file": str(SHOW.resolve()), "drone": 1}
while True:
    try:
        path = ptnsbc.load("paper_5_free", **{"leader.trajectory": drone}).leader.trajectory
    except ptnsbc.PtnsbcError as error:  # there is no further one
        if not curves:
            raise SystemExit(f"{SHOW}: {error}") from None
        break
    curves.append(trajectory_of(path))
    drone = {**drone, "drone": len(curves) + 1}

times = [float(t) for t in np.arange(FORMED_S, curves[0].table[-1, 0], EVERY_S)]
places = np.round([[reference(of, t).position for of in curves] for t in (0.0, *times)], 3)
first, *later = [dict(enumerate((at[1:] - at[0]).tolist(), 2)) for at in places[1:]]
followers = list(range(2, len(curves) + 1))
scenario = ptnsbc.load(
    {
        "extends": "paper_5_free",
        "name": "show",
        "timing": {"duration_s": times[-1]},
        "leader": {"trajectory": {**drone, "drone": 1}},
        "gains": {"formation": {"deadline_s": FORMED_S}},
        "communication": {
            "tree": "auto",
            "leader_links": followers,
            "estimator_edges": [list(pair) for pair in pairwise(followers)],
        },
        "formation": {
            "task": "relative_position",
            "assignment": "optimal",  # who is nearest takes a place
            "offsets_m": first,
            "changes": [
                {"at_s": t, "over_s": EVERY_S, "offsets_m": to}
                for t, to in zip(times[:-1], later, strict=True)
            ],
        },
        "uavs": [{"id": n, "position_m": [x, y, 1.0]} for n, (x, y, _) in enumerate(places[0], 1)],
    }
)
ptnsbc.check(scenario, dry_runs=0).refuse()
flight = ptnsbc.fly(scenario)
print(len(curves), "drones:", flight.verdict.verdict)
print("picture:", flight.save_picture(OUT / "show.png"))
(OUT / "show.yaml").write_text(scenario.text, encoding="utf-8")  # for check, simulate and fleet
