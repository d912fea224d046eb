"""First flight: Simulation 1 of the paper, checked, flown and judged; its paths and errors in one picture."""

import sys
from pathlib import Path

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")

scenario = ptnsbc.load("paper_5")
report = ptnsbc.check(scenario, dry_runs=5)
print(f"{len(report)} findings, ready to fly: {report.ok}")

flight = ptnsbc.fly(scenario)
for uav in flight.verdict.uavs:
    print(
        f"UAV {uav.uav}: {uav.verdict}, settled after {uav.settling_s:.2f} of {uav.deadline_s:g} s"
    )
print("picture:", flight.save_picture(OUT / "first_flight.png"))
