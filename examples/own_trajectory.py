"""Own trajectory: the leader on a straight climb instead of the paper's circle, path and error side by side."""

import sys
from pathlib import Path

from matplotlib import pyplot as plt

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")

climb = {"kind": "line", "position_m": [0, 2, 3], "velocity_m_s": [0.8, 0.3, 0.2], "yaw_rad": 0.36}
paper = ptnsbc.load("paper_5_free")
flights = {
    "circle": ptnsbc.fly(paper),
    "climb": ptnsbc.fly(
        ptnsbc.load({"extends": "paper_5_free", "name": "climb", "leader": {"trajectory": climb}})
    ),
}
figure, panels = plt.subplots(2, 2, figsize=(11, 8), layout="constrained")
for (above, below), (name, flight) in zip(panels.T, flights.items(), strict=True):
    flight.plot_paths(above).set_title(f"{name}: {flight.verdict.verdict}")
    flight.plot_errors(below)
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "own_trajectory.png")
