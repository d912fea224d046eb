"""A fleet on two computers (network namespaces), a fifth of the packets between them lost: starts and deadlines.

Three UAVs, sim and recorder on one, two UAVs on the other, with the profiles that `ptnsbc network` writes. A start
counts when the flight begins within a minute and a half. Needs root, iproute2 and nftables.
"""

from __future__ import annotations

import json
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from bench import namespaces
from bench.launch import BenchError
from bench.namespaces import Computer
from bench.session import Plan, say
from bench.table import Row
from ptnsbc_nodes.network import SERVER_PORT
from ptnsbc_nodes.warmup import load_agent, load_world
from ptnsbc_sim.scenario import load_scenario

_DOMAIN = 71
_LOST_PERCENT = 20
_PATIENCE_S = 90.0
_FARTHEST = 5  # the UAV with the longest way to the leader, on the other computer

Pair = tuple[Computer, Computer]


class Case(NamedTuple):
    """What flies, and how its processes find each other."""

    servers: int  # 0: static peers
    plant: str
    times: int

    @property
    def name(self) -> str:
        """As in the table."""
        found_by = ("static peers", "a server", "two servers")[self.servers]
        return f"{found_by}, {self.plant}, {_LOST_PERCENT} % lost"


class Flown(NamedTuple):
    """What came of one flight."""

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
        Case(0, "quadrotor", plan.of(4, 1)),
        Case(0, "rigid_body_6dof", plan.of(4, 1)),
        Case(1, "rigid_body_6dof", plan.of(12, 1)),
        Case(2, "rigid_body_6dof", plan.of(12, 1)),
    ]
    return [row for case in cases for row in _rows(case)]


def _rows(case: Case) -> Iterator[Row]:
    flown = []
    for turn in range(case.times):
        say(f"network: {case.name}, {turn + 1} of {case.times}")
        with namespaces.two_computers(_LOST_PERCENT) as pair, _profile(case, pair) as profile:
            flown.append(_fly(case, pair, profile))
    begun = [one for one in flown if one is not None]
    settled = [one.settled_s for one in begun if one.settled_s is not None]
    met = sum(one.verdict == "met" for one in begun)
    yield Row(f"{case.name}: starts", [float(len(begun))], f"of {case.times}")
    yield Row(f"{case.name}: deadline met", [float(met)], f"of {len(begun)}")
    if settled:
        yield Row(f"{case.name}: UAV {_FARTHEST} settled after", settled, "s")


@contextmanager
def _profile(case: Case, pair: Pair) -> Iterator[Path]:
    """The file that both computers fly with, and its servers, all on the ground."""
    ground, away = pair
    places = [f"{ground.address}:{SERVER_PORT + number}" for number in range(case.servers)]
    words = ("server", *places) if places else ("peers", ground.address, away.address)
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        file = Path(folder) / "fleet.xml"
        namespaces.finished(ground.ptnsbc("network", *words, "-o", file))
        servers = [
            ground.ptnsbc("network", "serve", place, "--id", number)
            for number, place in enumerate(places)
        ]
        try:
            yield file
        finally:
            for server in servers:
                server.send_signal(signal.SIGINT)
                namespaces.finished(server)


def _fly(case: Case, pair: Pair, profile: Path) -> Flown | None:
    """None when the fleet does not get ready."""
    words = ("paper_5", "--domain", _DOMAIN, "--plant", case.plant, "--duration", 8)
    ground, away = pair
    running = [
        computer.ptnsbc("fleet", *words, "--json", "--only", only, "--network", profile)
        for computer, only in ((away, "4,5"), (ground, "recorder,sim,1,2,3"))
    ]
    try:
        out, _ = running[1].communicate(timeout=_PATIENCE_S)
    except subprocess.TimeoutExpired:
        for process in running:
            process.send_signal(signal.SIGINT)
        said = [namespaces.finished(process)[2] for process in running]
        waits = [line for line in said[1].splitlines() if " waits for " in line]
        say("\n".join(["network: it did not start in time:", *waits[-4:]]))
        return None
    namespaces.finished(running[0])
    told = json.loads(out)
    (last,) = [uav for uav in told["uavs"] if uav["uav"] == _FARTHEST]
    return Flown(told["verdict"], last["settling_s"])
