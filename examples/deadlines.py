"""The deadline is chosen, the law keeps it: errors for three deadlines from the same start."""

import sys
from pathlib import Path

from matplotlib import pyplot as plt

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")

figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
for deadline_s in (4.0, 6.0, 8.0):
    scenario = ptnsbc.load("paper_5_free").with_(
        {"gains.formation.deadline_s": deadline_s, "timing.duration_s": 12}
    )
    flight = ptnsbc.fly(scenario)
    line = axes.semilogy(
        flight.time_s, flight.error_m.max(axis=1), label=f"deadline {deadline_s:g} s"
    )
    axes.axvline(deadline_s, color=line[0].get_color(), linestyle=":")
    print(f"{deadline_s:g} s: {flight.verdict.verdict}")
axes.axhline(0.05, color="grey", linewidth=1)
axes.set(xlabel="time after the epoch [s]", ylabel="largest formation error [m]")
axes.legend()
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "deadlines.png")
