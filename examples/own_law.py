"""Laws of one's own against ours: consensus, a potential field and a CBF-QP, over the same draws of starts."""

import sys
import time
from pathlib import Path

from matplotlib import pyplot as plt

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")
LAWS = Path(__file__).with_name("laws")
DRAWS = {"runs": 4, "starts": "near:0.5", "seed": 3, "workers": 1}

ours = ptnsbc.load("paper_5_free").with_({"timing.duration_s": 8})
scenarios = {
    "ours": ours,
    "consensus": ours.with_(law=f"{LAWS}/consensus.py:consensus"),
    "potential field": ours.with_(
        {"law": f"{LAWS}/potential_field.py:potential_field", "formation.avoidance": "off"}
    ),
    "CBF-QP": ours.with_({"law": f"{LAWS}/cbf_qp.py:cbf_qp", "formation.avoidance": "off"}),
}
figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
first = None
for name, scenario in scenarios.items():
    began = time.process_time()
    flown = ptnsbc.sweep(scenario, **DRAWS)
    took = time.process_time() - began  # of a processor; at the first use with the compilation
    first = first or flown
    worse = ptnsbc.compare(first, flown).worse
    print(f"{name}: {flown.met}; worse than ours: {worse}; {took:.2f} s")
    flight = flown.fly(0)
    axes.semilogy(flight.time_s, flight.error_m[:, 1:].max(axis=1), label=name)
axes.axvline(ours.gains.formation.deadline_s, color="black", linewidth=1)
axes.axhline(0.05, color="grey", linewidth=1)
axes.set(
    xlabel="time after the epoch [s]", ylabel="largest error of a follower [m]", title="draw 0"
)
axes.legend()
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "own_law.png")
