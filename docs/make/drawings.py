"""`python -m docs.make.drawings`: the drawings of docs/concepts.md, by the functions of the laws themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("svg")
from matplotlib import pyplot as plt
from matplotlib.patches import Circle

import ptnsbc
from ptnsbc_core.nullspace import compose, null_space_projector
from ptnsbc_core.timebase import h
from ptnsbc_io.files import replacing
from ptnsbc_sim.scenario.mission.shapes import nearest_places
from ptnsbc_tools.plotting.charts import COLOURS, GOOD, OBSTACLE

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "docs" / "img" / "concepts"
BLUE, ORANGE, GREEN, RED, PURPLE = COLOURS[:5]
DEADLINE_S = 5.0
mpl.rcParams.update(
    {
        "svg.hashsalt": "ptnsbc",
        "font.size": 10,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "legend.frameon": False,
        "figure.facecolor": "white",
    }
)


def time_base() -> Any:
    """h, and what it makes of three start errors; beside it an exponential decay."""
    t = np.linspace(0.0, 1.4 * DEADLINE_S, 400)
    rise = np.array([h(one / DEADLINE_S) for one in t])
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    left.plot(t, rise, color=BLUE)
    left.set(xlabel="time after the epoch [s]", ylabel="h [1]", title="The time base")
    for start, colour in ((8.0, BLUE), (4.0, GREEN), (1.0, PURPLE)):
        right.plot(t, start * (1.0 - rise), color=colour, label=f"from {start:g} m")
        right.plot(t, start * np.exp(-t), color=colour, linewidth=1, linestyle=":")
    right.set(xlabel="time after the epoch [s]", ylabel="error [m]")
    right.set_title("Every start arrives at the deadline")
    right.plot([], [], color="k", linewidth=1, linestyle=":", label="exponential, rate 1/s")
    for axes in (left, right):
        axes.axvline(DEADLINE_S, color="k", linewidth=1)
        axes.text(DEADLINE_S + 0.05, axes.get_ylim()[1] * 0.93, "deadline", fontsize=9)
    right.legend(fontsize=9)
    return figure


def null_space() -> Any:
    """The velocity of the formation, what of it changes the distance to an obstacle, and what is left."""
    obstacle, uav = np.array([0.0, 0.0]), np.array([-1.5, 0.55])
    away = (uav - obstacle) / np.linalg.norm(uav - obstacle)
    jacobian = np.array([[*away, 0.0]])
    wanted = np.array([1.5, 0.25, 0.0])
    clear = np.array([*(0.35 * away), 0.0])
    left = null_space_projector(jacobian) @ wanted
    velocities = np.array([clear, wanted])
    flown = compose(velocities, jacobian, np.array([1, 0])).sum(axis=0)
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    axes.add_patch(Circle(obstacle, 1.0, color=OBSTACLE, alpha=0.25))
    axes.text(*obstacle, "keep-out", ha="center", va="center")
    axes.plot(*uav, "o", color="k")
    axes.plot(*zip(obstacle, uav, strict=True), color=OBSTACLE, linestyle=":", linewidth=1)
    for vector, colour, label in (
        (wanted, BLUE, "the formation's velocity"),
        (left, GREEN, "its part in the null space of the clearance"),
        (clear, ORANGE, "the clearance's velocity"),
        (flown, "k", "flown: clearance + null-space part"),
    ):
        axes.annotate(
            "",
            uav + vector[:2],
            uav,
            arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 2},
        )
        axes.plot([], [], color=colour, label=label)
    axes.set(xlim=(-2.2, 2.6), ylim=(-1.1, 1.9), aspect="equal", xlabel="east [m]")
    axes.set_ylabel("north [m]")
    axes.legend(fontsize=9, loc="upper right")
    return figure


def slots() -> Any:
    """The ways of the UAVs to their slots: fixed by the scenario, and with the smallest sum of squared distances."""
    places = np.array([[0.0, 0.0, 0.0], [-1, 1, 0], [-1, -1, 0], [-2, 2, 0], [-2, -2, 0]])
    starts = np.array(
        [[-3.6, -1.2, 0.0], [0.4, -2.2, 0], [-2.8, 2.6, 0], [-0.2, 1.6, 0], [-4, 0.6, 0]]
    )
    chosen = [np.arange(5), nearest_places(starts, places, centred=True)]
    figure, both = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained", sharey=True)
    for axes, order, title in zip(both, chosen, ("fixed", "optimal"), strict=True):
        total = 0.0
        for uav, slot in enumerate(order):
            axes.annotate(
                "",
                places[slot, :2],
                starts[uav, :2],
                arrowprops={"arrowstyle": "-|>", "color": COLOURS[uav], "linewidth": 1.8},
            )
            axes.plot(*starts[uav, :2], "o", color=COLOURS[uav], markersize=9)
            axes.plot(*places[slot, :2], "o", color=COLOURS[uav], markersize=12, fillstyle="none")
            axes.text(starts[uav, 0] - 0.15, starts[uav, 1], f"{uav + 1}", ha="right", va="center")
            total += float(np.sum((places[slot] - starts[uav]) ** 2))
        axes.set(
            title=f"assignment: {title}, sum {total:.1f} m²", xlabel="east [m]", aspect="equal"
        )
        axes.margins(0.12)
    both[0].set_ylabel("north [m]")
    return figure


def verdict() -> Any:
    """The errors of the recorded sample, with what the verdict looks at."""
    flight = ptnsbc.read_bag(ROOT / "bags" / "sample")
    judged = flight.verdict
    assert judged is not None
    deadline = flight.scenario.gains.formation.deadline_s
    limit = flight.scenario.formation.tolerance_m
    figure, axes = plt.subplots(figsize=(9, 3.4), layout="constrained")
    for row, uav in enumerate(flight.uavs):
        errors = np.maximum(flight.error_m[:, row], 1e-4)
        axes.semilogy(flight.time_s, errors, color=COLOURS[row], linewidth=1.3, label=f"UAV {uav}")
    axes.axvline(deadline, color="k", linewidth=1.2)
    axes.axhline(limit, color="k", linewidth=1, linestyle=":")
    end = float(flight.time_s[-1])
    axes.axvspan(deadline, end, color=GOOD, alpha=0.1, linewidth=0)
    axes.text(deadline + 0.05, axes.get_ylim()[1] * 0.5, f"deadline {deadline:g} s", fontsize=9)
    axes.text(end, limit * 1.15, f"tolerance {limit:g} m", ha="right", fontsize=9)
    axes.text((deadline + end) / 2, 2e-4, "must stay below the tolerance", ha="center", fontsize=9)
    axes.set(xlabel="time after the epoch [s]", ylabel="formation error [m]")
    axes.set(xlim=(0.0, end), title=f"{flight.scenario.name}: {judged.verdict}")
    axes.legend(fontsize=9, ncols=5, loc="lower left")
    return figure


def main() -> None:
    """Write all drawings."""
    OUT.mkdir(parents=True, exist_ok=True)
    for draw in (time_base, null_space, slots, verdict):
        path = OUT / f"{draw.__name__}.svg"
        with replacing(path) as part:
            draw().savefig(part, format="svg", metadata={"Date": None})
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
