"""A real-time fleet from Python: one ROS 2 process per UAV by the wall clock, beside the flight in one process."""

import sys
from pathlib import Path

from matplotlib import pyplot as plt

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")


def main() -> None:
    """Fly three UAVs for six seconds, twice."""
    scenario = ptnsbc.load(Path(__file__).with_name("three.yaml"))
    flights = {
        "one process": ptnsbc.fly(scenario),
        "fleet, by the wall clock": ptnsbc.fly_fleet(scenario),
    }
    figure, panels = plt.subplots(1, 2, figsize=(12, 4.5), sharey=True, layout="constrained")
    for axes, (name, flight) in zip(panels, flights.items(), strict=True):
        flight.plot_errors(axes).set_title(f"{name}: {flight.verdict.verdict}")
        print(name, flight.verdict.latency_ms)
    OUT.mkdir(parents=True, exist_ok=True)
    figure.savefig(OUT / "fleet.png")


if __name__ == "__main__":
    main()
