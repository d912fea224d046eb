"""A fleet on two and three computers (network namespaces), a fifth of the packets lost: starts and deadlines.

With static peers three UAVs, sim and recorder are on one computer and two UAVs on the other; with a discovery server
each of two further computers has two UAVs. They fly with the profiles that `ptnsbc network` writes. A start counts
when the flight is over within two minutes and a half. Needs root, iproute2 and nftables.
"""

from __future__ import annotations

import json
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from bench import namespaces
from bench.launch import BenchError
from bench.namespaces import Computer
from bench.session import Plan, print_progress
from bench.table import Row
from ptnsbc_nodes.runtime.warmup import load_agent, load_world
from ptnsbc_sim.scenario import load_scenario

_DOMAIN = 71
_LOST_PERCENT = 20
_PATIENCE_S = 150.0
_FARTHEST = 5  # the UAV with the longest way to the leader, on the other computer

_TWO = ("recorder,sim,1,2,3", "4,5")
_THREE = ("recorder,sim,1", "2,3", "4,5")


class Case(NamedTuple):
    """One case: the fleet that flies, and the way its processes find each other."""

    server: bool  # or static peers
    plant: str
    parts: tuple[str, ...]  # processes on each computer, the ground first
    times: int

    @property
    def name(self) -> str:
        """As in the table."""
        found_by = "a discovery server" if self.server else "static peers"
        return f"{len(self.parts)} computers, {found_by}, {self.plant}, {_LOST_PERCENT} % lost"


class Flown(NamedTuple):
    """The outcome of one flight."""

    verdict: str
    settled_s: float | None  # of UAV 5 after the epoch


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    reason = namespaces.missing()
    if reason is not None:
        raise BenchError(reason)
    for plant in ("quadrotor", "rigid_body_6dof"):  # compiled before the patience runs
        scenario = load_scenario("paper_5", {"plant.kind": plant})
        load_agent(scenario, scenario.leader_id)
        load_world(scenario)
    cases = [
        Case(False, "quadrotor", _TWO, plan.of(4, 1)),
        Case(False, "rigid_body_6dof", _TWO, plan.of(4, 1)),
        Case(True, "rigid_body_6dof", _THREE, plan.of(20, 1)),
    ]
    return [row for case in cases for row in _rows(case)]


def _rows(case: Case) -> Iterator[Row]:
    flown = []
    for turn in range(case.times):
        print_progress(f"network: {case.name}, {turn + 1} of {case.times}")
        with (
            namespaces.computers(len(case.parts), _LOST_PERCENT) as computers,
            _profile(case, computers) as profile,
        ):
            flown.append(_fly(case, computers, profile))
    begun = [one for one in flown if one is not None]
    settled = [one.settled_s for one in begun if one.settled_s is not None]
    met = sum(one.verdict == "met" for one in begun)
    yield Row(f"{case.name}: starts", [float(len(begun))], f"of {case.times}")
    yield Row(f"{case.name}: deadline met", [float(met)], f"of {len(begun)}")
    if settled:
        yield Row(f"{case.name}: UAV {_FARTHEST} settled after", settled, "s")


@contextmanager
def _profile(case: Case, computers: Sequence[Computer]) -> Iterator[Path]:
    """The file that all computers fly with, and the server on the ground where there is one."""
    ground, addresses = computers[0], [computer.address for computer in computers]
    words = ("server", ground.address) if case.server else ("peers", *addresses)
    with tempfile.TemporaryDirectory(prefix="bench-") as folder, ExitStack() as stack:
        file = Path(folder) / "fleet.xml"
        namespaces.finished(ground.ptnsbc("network", *words, "-o", file))
        if case.server:
            server = ground.ptnsbc("network", "serve", ground.address)
            stack.callback(namespaces.finished, server)
            stack.callback(server.send_signal, signal.SIGINT)
        yield file


def _fly(case: Case, computers: Sequence[Computer], profile: Path) -> Flown | None:
    """None when the fleet does not get ready."""
    words = ("paper_5", "--domain", _DOMAIN, "--plant", case.plant, "--duration", 8)
    running = [
        computer.ptnsbc("fleet", *words, "--json", "--only", only, "--network", profile)
        for computer, only in zip(computers, case.parts, strict=True)
    ]
    try:
        out, _ = running[0].communicate(timeout=_PATIENCE_S)
    except subprocess.TimeoutExpired:
        for process in running:
            process.send_signal(signal.SIGINT)
        said = [namespaces.finished(process)[2] for process in running]
        waits = [line for line in said[0].splitlines() if " waits for " in line]
        print_progress("\n".join(["network: it did not start in time:", *waits[-4:]]))
        return None
    for process in running[1:]:
        namespaces.finished(process)
    verdict = json.loads(out)
    if verdict["verdict"] is None:
        raise BenchError(f"{case.name}: {verdict['error']}")
    (last,) = [uav for uav in verdict["uavs"] if uav["uav"] == _FARTHEST]
    return Flown(verdict["verdict"], last["settling_s"])
