"""A sweep: how much delay do links stand? The share of flights met with its interval, over a list of delays."""

import sys
from pathlib import Path

import ptnsbc

OUT = Path(sys.argv[1] if sys.argv[1:] else "out/examples")

flown = ptnsbc.sweep(
    ptnsbc.load("paper_5"),
    runs=6,
    vary={"communication.delay_s": "0,0.1,0.2,0.3,0.4"},
    starts="near:0.3",
    stop_after_s=10,
    seed=4,
    workers=1,
)
print(flown)
for delay in sorted(set(flown["drawn.communication.delay_s"])):
    rows = flown["drawn.communication.delay_s"] == delay
    print(
        f"{delay:.1f} s: largest error after the deadline {flown['largest_after_m'][rows].max():.3f} m"
    )
axes = flown.plot_met()
OUT.mkdir(parents=True, exist_ok=True)
axes.figure.savefig(OUT / "sweep.png")
