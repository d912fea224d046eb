"""Disturbances: gusts, RTK positions and lost messages one after the other, and what each does to the error."""

import sys
from pathlib import Path

from matplotlib import pyplot as plt

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")

CASES = {
    "calm": {},
    "gusts of 2 m/s": {"world.wind_m_s": [4, 0, 0], "world.gust_m_s": [2, 2, 0.5]},
    "positions to 2 cm": {"sensor.positioning": {"noise_m": 0.02, "rate_hz": 10}},
    "a fifth of all messages lost": {"communication.loss": 0.2},
}
figure, axes = plt.subplots(figsize=(9, 4.5), layout="constrained")
for name, keys in CASES.items():
    scenario = ptnsbc.load("paper_5_free", seed=5).with_(keys)
    flight = ptnsbc.fly(scenario)
    after = flight.time_s > scenario.gains.formation.deadline_s
    print(
        f"{name}: {flight.verdict.verdict}, {flight.error_m[after].max():.4f} m after the deadline"
    )
    axes.semilogy(flight.time_s, flight.error_m.max(axis=1), label=name, linewidth=1)
axes.axvline(scenario.gains.formation.deadline_s, color="black", linewidth=1)
axes.set(xlabel="time after the epoch [s]", ylabel="largest true formation error [m]")
axes.legend()
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "disturbances.png")
