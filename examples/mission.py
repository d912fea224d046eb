"""A mission: form, go to a gate, become a line, land; paths and errors with the verdict of each leg."""

import sys
from pathlib import Path

from matplotlib import pyplot as plt

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")

legs = [
    {"kind": "form", "over_s": 7, "stay_s": 1},
    {"kind": "go_to", "name": "gate", "position_m": [6, 4, 6], "over_s": 9},
    {"kind": "change", "name": "line", "shape": {"kind": "line", "spacing_m": 2}, "over_s": 6},
    {"kind": "land", "over_s": 18},
]
scenario = ptnsbc.load("mission_6").with_({"mission.legs": legs, "timing.duration_s": 42})
flight = ptnsbc.fly(scenario)
for leg in flight.verdict.mission:
    print(f"{leg.name}: {leg.verdict}, largest error {leg.error_m:.3f} m")
figure, (above, below) = plt.subplots(2, 1, figsize=(8, 9), layout="constrained")
flight.plot_paths(above).set_title(f"mission: {flight.verdict.verdict}")
flight.plot_errors(below)
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "mission.png")
