"""Reading a bag: what the sample flight commanded, and how far estimates of the leader were off."""

import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")
BAG = Path(__file__).parents[1] / "bags" / "sample"

flight = ptnsbc.read_bag(BAG)
print(flight)
leader = flight.uavs.index(flight.scenario.leader.id)
off_m = np.linalg.norm(flight.leader_estimate_m - flight.position_m[:, [leader]], axis=2)
thrust_n = np.linalg.norm(flight.force_n, axis=2)

figure, (above, below) = plt.subplots(2, 1, figsize=(9, 6), sharex=True, layout="constrained")
for row, uav in enumerate(flight.uavs):
    above.plot(flight.time_s, thrust_n[:, row], label=f"UAV {uav}", linewidth=1)
    if row != leader:
        below.semilogy(flight.time_s, off_m[:, row], label=f"UAV {uav}", linewidth=1)
above.set(ylabel="force [N]", title=f"{flight.scenario.name}: {flight.verdict.verdict}")
below.set(xlabel="time after the epoch [s]", ylabel="error of the leader estimate [m]")
below.legend(fontsize=8)
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "read_bag.png")
