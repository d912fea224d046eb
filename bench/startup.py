"""Before the first tick: compiling the laws once, and starting a process with them compiled.

As a module it compiles everything in an empty cache.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from bench.session import Plan, cpu_seconds, own_domain, print_progress, take_turns
from bench.table import Row, Target

_DEADLINE_S = 30.0
_LOOK_S = 0.002
_NODE_HZ = 5.0  # as the status of ours
_LEADER = "1"


class Start(NamedTuple):
    """One process, from its creation to its first status received by another process."""

    wall_s: float
    cpu_s: float
    rss_mb: float


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section; compilation takes minutes and is left out when it has to be quick."""
    return [*_ready(plan), *([] if plan.quick else _compilation())]


def _compilation() -> list[Row]:
    print_progress("startup: compiling everything once")
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        done = subprocess.run(
            [sys.executable, "-m", __spec__.name],
            env={
                **os.environ,
                "PTNSBC_CACHE_DIR": folder,
                "PYTHONPATH": str(Path(__file__).resolve().parents[1]),
            },
            stdout=subprocess.PIPE,
            check=True,
            text=True,
        )
    found: dict[str, float] = json.loads(done.stdout)
    fleet_s, target = found["fleet"], Target(90.0)
    return [
        Row("first compilation, fleet", [fleet_s], "s", target=target),
        Row("first compilation, headless too", [fleet_s + found["headless"]], "s", target=target),
    ]


def _compile() -> dict[str, float]:
    """In a fresh process with an empty cache: CPU time of each first call."""
    from bench.scenarios import paper
    from ptnsbc_nodes.runtime.warmup import load_agent, load_world
    from ptnsbc_sim.swarm import fly

    scenario = paper(0.1)

    def fleet() -> None:
        load_agent(scenario, scenario.leader.id)
        load_world(scenario)

    return {
        "fleet": cpu_seconds(fleet),
        "headless": cpu_seconds(lambda: fly(scenario)),
    }


def _ready(plan: Plan) -> list[Row]:
    from bench.scenarios import paper
    from ptnsbc_nodes.runtime.warmup import load_agent

    scenario = paper(1.0)
    load_agent(scenario, int(_LEADER))
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        folder = Path(name)
        file = folder / "scenario.yaml"
        file.write_text(scenario.text, encoding="utf-8")
        own = ("ptnsbc_nodes.uav.uav_main", "--scenario", str(file), "--uav", _LEADER, "--lockstep")
        found = take_turns(
            {
                "bare node": lambda: _start(folder, "bench.processes", "node", f"{_NODE_HZ:g}"),
                "UAV": lambda: _start(folder, *own),
            },
            plan.of(7, 2),
            "startup",
        )
    bare, ours = ([*zip(*starts, strict=True)] for starts in found.values())
    name = "bare rclpy node"
    return [
        Row("warm UAV ready", ours[0], "s", name, bare[0], target=Target(2.0)),
        Row("CPU time until then", ours[1], "s", name, bare[1], target=Target(1.25)),
        Row("memory then", ours[2], "MB", name, bare[2], target=Target(110.0)),
    ]


def _start(folder: Path, module: str, *arguments: str) -> Start:
    from bench.processes import BenchError, Observer, look
    from ptnsbc_nodes.fleet.child_process import ChildProcess, ProcessCommand, end
    from ptnsbc_nodes.runtime import environment

    with own_domain() as domain, Observer(domain) as observer:
        settings = environment.for_children(domain, 2, folder)
        began = time.monotonic()
        child = ChildProcess(ProcessCommand("node", module, arguments), settings, folder)
        try:
            while (heard_at := observer.first_at()) is None:
                if child.exit_code is not None or time.monotonic() > began + _DEADLINE_S:
                    raise BenchError(f"{module}: no status received\n{child.tail()}")
                time.sleep(_LOOK_S)
            return Start(heard_at - began, *look(child.pid)[1:])
        finally:
            end([child])


if __name__ == "__main__":
    print(json.dumps(_compile()))
