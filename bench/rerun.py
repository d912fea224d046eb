"""Re-run of a recorded flight of five UAVs: how many times faster than it was flown, start-up included."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from bench.scenarios import paper
from bench.session import Plan, print_progress
from bench.table import Row, Target
from ptnsbc_sim.swarm import fly
from ptnsbc_tools.reading.headless import write_flight

_FASTER = 20.0


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        print_progress("rerun: recording a flight")
        seconds = plan.of(60.0, 3.0)
        bag = write_flight(fly(paper(seconds)), Path(name) / "flight")
        found = []
        for turn in range(plan.of(5, 1)):
            print_progress(f"rerun: {turn + 1}")
            found.append(_rerun(bag))
    target = Target(_FASTER, at_least=True)
    return [Row(f"re-run of {seconds:.0f} s", found, "times real time", target=target)]


def _rerun(bag: Path) -> float:
    command = [sys.executable, "-m", "ptnsbc_tools.cli", "replay", str(bag), "--rerun", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(json.loads(done.stdout)["times_real_time"])
