"""Another simulator on the same machine, where it is installed: it is in no lock.

drone-models runs in a process of its own, on two cores, by the interpreter in PTNSBC_PEERS_PYTHON, or by this one. Its
drones are uncoupled: no laws of a formation, no sensors, no messages, nothing recorded.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from bench.session import Plan, print_progress
from bench.table import Row

_PEER = "drone_models_loop"
_CORES = 2


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section; none where the peer is not installed."""
    figures = _measured(_PEER, plan.of(3.0, 0.5))
    if figures is None:
        return []
    name = str(figures["peer"])
    return [
        Row(f"{name}, 5 drones", [float(figures["swarm"])], "swarm-ticks/s"),
        Row(f"{name}, 5000 drones", [float(figures["drones"])], "drone-ticks/s"),
    ]


def _measured(peer: str, seconds: float) -> dict[str, str | float] | None:
    python = os.environ.get("PTNSBC_PEERS_PYTHON", sys.executable)
    command = [python, str(Path(__file__).with_name(f"{peer}.py")), str(seconds)]
    with tempfile.TemporaryDirectory() as folder:  # MuJoCo writes a log where it runs
        done = subprocess.run(
            command, capture_output=True, text=True, cwd=folder, preexec_fn=_on_two_cores
        )
    if done.returncode:
        why = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        print_progress(f"peers: {peer}: skipped: {why[0]}")
        return None
    found: dict[str, str | float] = json.loads(done.stdout.splitlines()[-1])
    return found


def _on_two_cores() -> None:
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:_CORES])
