"""A task of one's own against two of ours: cylinder coordinates beside the parent, from the same start."""

import sys
from pathlib import Path

from matplotlib import pyplot as plt

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")
OWN = Path(__file__).parent / "plugins" / "cylinder.py"

base = ptnsbc.load("paper_5_free").with_(
    {"formation.approach": "task", "timing.duration_s": 8}  # the task itself closes every error
)
scenarios = {
    "cylinder (own)": base.with_({"plugins.task": f"{OWN}:cylinder"}),
    "relative_position": base.with_({"formation.task": "relative_position"}),
    "distance_angles": base.with_({"formation.task": "distance_angles"}),
}
figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
for name, scenario in scenarios.items():
    flight = ptnsbc.fly(scenario)
    print(f"{name}: {flight.verdict.verdict}")
    axes.semilogy(flight.time_s, flight.error_m[:, 1:].max(axis=1), label=name)
axes.axvline(base.gains.formation.deadline_s, color="black", linewidth=1)
axes.set(xlabel="time after the epoch [s]", ylabel="largest error of a follower [m]")
axes.legend()
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "own_task.png")
