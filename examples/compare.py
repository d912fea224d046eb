"""Comparison with a baseline: the paper's law closes every error by its task; ours forms by planned paths first."""

import sys
from pathlib import Path

from matplotlib import pyplot as plt

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")
DRAWS = {"runs": 10, "starts": "near:1.0", "stop_after_s": 9.0, "seed": 11, "workers": 1}

ours = ptnsbc.load("paper_5_free")
printed = ours.with_({"formation.approach": "task"})
a, b = ptnsbc.sweep(ours, **DRAWS), ptnsbc.sweep(printed, **DRAWS)
found = ptnsbc.compare(a, b, names=["task"])
print(f"planned: {a.met}\ntask: {b.met}")
print(found)

figure, axes = plt.subplots(figsize=(6, 5), layout="constrained")
first, second = (one.flown.table.of_flights("error_at_deadline_m") for one in (a, b))
axes.loglog(first, second, "o", markersize=4)
ends = [min(first.min(), second.min()), max(first.max(), second.max())]
axes.loglog(ends, ends, color="grey", linewidth=1)
axes.set(xlabel="planned: error at the deadline [m]", ylabel="task: error at the deadline [m]")
axes.set_title("Each point is one draw; above the line the task alone is worse")
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "compare.png")
