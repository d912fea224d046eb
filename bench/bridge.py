"""MAVLink bridges in flight: CPU, and the time from odometry in to setpoint out, four vehicles over UDP.

The whole fleet as a user flies it, against four stand-ins. The time runs from the packet with the position
to the setpoint that answers it: ROS both ways, the step of the UAV, and the wait for the next beat of the stream.
"""

from __future__ import annotations

import socket
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from bench.autopilot import stand_ins
from bench.launch import BenchError
from bench.observer import Observer
from bench.session import Plan, own_domain, print_progress
from bench.table import Row
from bench.usage import Sampler, Usage, look
from ptnsbc_nodes.fleet.fleet import FleetOptions, run_fleet
from ptnsbc_sim.scenario import Scenario, load_scenario

_SETPOINTS = ("velocity", "attitude")


class _Flown(NamedTuple):
    p50_ms: float  # of the slowest bridge
    p99_ms: float
    largest_ms: float
    usage: Mapping[str, Usage]
    stand_in_cores: float


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    rows: list[Row] = []
    for setpoint in plan.of(_SETPOINTS, _SETPOINTS[:1]):
        flights = [_fly(setpoint, plan.of(20.0, 8.0)) for _ in range(plan.of(2, 1))]
        name = f"four PX4 by {setpoint}"
        rows += [
            Row(f"{name}: odometry in to setpoint out, median", [f.p50_ms for f in flights], "ms"),
            Row(f"{name}: the same, 99 %", [f.p99_ms for f in flights], "ms"),
            Row(f"{name}: the same, largest", [f.largest_ms for f in flights], "ms"),
            Row(f"{name}: CPU of one bridge", [f.usage["bridge"].cores for f in flights], "cores"),
            Row(f"{name}: CPU of one UAV", [f.usage["uav"].cores for f in flights], "cores"),
            Row(f"{name}: CPU of the stand-ins", [f.stand_in_cores for f in flights], "cores"),
        ]
    return rows


def _fly(setpoint: str, seconds: float) -> _Flown:
    print_progress(f"bridge: four in formation by {setpoint}")
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        folder = Path(name)
        scenario = _scenario(setpoint, seconds)
        (folder / "scenario.yaml").write_text(scenario.text, encoding="utf-8")
        return _observed(scenario, folder)


def _observed(scenario: Scenario, folder: Path) -> _Flown:
    with (
        own_domain() as domain,
        stand_ins("--scenario", str(folder / "scenario.yaml"), "--boot-time", "0.1") as pid,
        Observer(domain) as observer,
        Sampler() as sampler,
    ):
        before = look(pid)

        def progress(line: str) -> None:
            nonlocal before
            if line.endswith("started"):
                sampler.begin()
                before = look(pid)

        options = FleetOptions(
            scenario, backend="mavlink", allow_arming=True, log_dir=folder / "logs"
        )
        result = run_fleet(options, progress)
        after, values_by_node = look(pid), observer.newest()
    if result.died or result.interrupted:
        raise BenchError(f"fleet of four stand-ins: interrupted or lost {result.died}")
    bridges = [values for name, values in values_by_node.items() if name.startswith("bridge")]
    p50, p99, largest = (
        max(float(values[f"latency_{figure}_ms"]) for values in bridges)
        for figure in ("p50", "p99", "max")
    )
    cores = (after.cpu_s - before.cpu_s) / (after.at - before.at)
    return _Flown(p50, p99, largest, sampler.usage(), cores)


def _scenario(setpoint: str, seconds: float) -> Scenario:
    """`experiment_4` on ports that are free now."""
    with socket.socket(type=socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        first = min(probe.getsockname()[1], 60000)
    links = {f"mavlink.vehicles.{i}.connect": f"udpin:127.0.0.1:{first + i}" for i in range(1, 5)}
    changes = {"timing.duration_s": seconds, "mavlink.setpoint": setpoint, **links}
    return load_scenario("experiment_4", changes).bridged()
