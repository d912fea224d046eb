"""A custom plot: the distance of every pair over time, with the keep-out and who avoids when."""

import sys
from itertools import combinations
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")

flight = ptnsbc.fly(ptnsbc.load("paper_5"))
at = dict(zip(flight.uavs, np.moveaxis(flight.position_m, 1, 0), strict=True))
active = flight.headless.track.diagnostics[:, :, 5] > 0  # rows of the clearance task, by UAV

figure, (above, below) = plt.subplots(
    2, 1, figsize=(9, 6), sharex=True, height_ratios=(3, 1), layout="constrained"
)
for first, second in combinations(flight.uavs, 2):
    apart = np.linalg.norm(at[first] - at[second], axis=1)
    above.plot(flight.time_s, apart, linewidth=1, label=f"{first} - {second}")
above.axhline(
    flight.scenario.formation.uav_keep_out_m, color="black", linestyle=":", label="keep-out"
)
above.set(ylabel="distance [m]", ylim=(0, None))
above.legend(ncols=4, fontsize=7)
below.imshow(
    active.T,
    aspect="auto",
    cmap="Greys",
    extent=(0, flight.time_s[-1], len(at) + 0.5, 0.5),
    interpolation="nearest",
)
below.set(xlabel="time after the epoch [s]", ylabel="UAV avoids", yticks=list(flight.uavs))
OUT.mkdir(parents=True, exist_ok=True)
figure.savefig(OUT / "custom_plot.png")
