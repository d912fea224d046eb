"""Fleets of real processes: real time beside a bare rclpy node, lock-step beside the headless flight."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from statistics import mean
from typing import NamedTuple

from bench.processes import BenchError, Observer, Sampler, Usage, bare_node, missed_percent
from bench.scenarios import grid, paper
from bench.session import Plan, cpu_seconds, own_domain, print_progress, take_turns
from bench.table import Row, Target
from ptnsbc_io.wire import HeaderFields
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.fleet.fleet import FleetOptions, FleetResult, run_fleet
from ptnsbc_nodes.runtime.node_process import ros_context, ros_node
from ptnsbc_nodes.uav.uav_node import UavNode
from ptnsbc_sim.counters import STATUS_HZ
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.swarm import fly as fly_headless

_MISSED, _STATUS, _RECORDER = Target(1.0), Target(3.0), Target(2.0)
_PROCESS = {"uav": "one UAV", "sim": "the sim", "recorder": "the recorder"}


class Flown(NamedTuple):
    """Figures of one flight; a figure that its mode does not have is 0."""

    steps_per_s: float
    missed_percent: float  # of the ticks of all UAVs
    latency_p50_ms: float  # odometry sent to wrench received
    latency_p99_ms: float
    lost_percent: float  # of the messages that a recorder should have had
    usage: Mapping[str, Usage]


class Case(NamedTuple):
    """One size of fleet in real time."""

    size: int
    control_hz: int
    bag: bool
    processes: int | None = None  # for the UAVs; one for each by default

    @property
    def name(self) -> str:
        """Like `N = 20, 50 Hz`."""
        shared = f", {self.processes} processes" if self.processes else ""
        return f"N = {self.size}, {self.control_hz} Hz{shared}{', recorded' if self.bag else ''}"


CASES = (
    Case(5, 100, bag=True),
    Case(20, 50, bag=False),
    Case(20, 50, bag=True),
    Case(20, 100, bag=False),
    Case(20, 100, bag=False, processes=4),
)


def measure(plan: Plan) -> Iterator[Row]:
    """Rows of this section, one fleet after the other: minutes are not lost with the last of them."""
    for case in plan.of(CASES, CASES[:1]):
        yield from _real_time(case, plan)
    yield from _lockstep(plan)


def fly(scenario: Scenario, *, lockstep: bool, bag: bool, processes: int | None = None) -> Flown:
    """Fly a fleet as `ptnsbc fleet` does, its UAVs in as many `processes`: one for each by default."""
    rate = 0.0
    with (
        tempfile.TemporaryDirectory(prefix="bench-") as folder,
        own_domain() as domain,
        nullcontext() if lockstep else Observer(domain) as observer,
        Sampler() as sampler,
    ):

        def progress(line: str) -> None:
            nonlocal rate
            if line.endswith("started"):
                sampler.begin()
            if line.endswith("steps/s"):
                rate = float(line.split()[-2])  # the last line is the average of the flight

        options = FleetOptions(
            scenario,
            lockstep=lockstep,
            bag=Path(folder) / "bag" if bag else None,
            log_dir=Path(folder) / "logs",
            processes=processes,
        )
        result = run_fleet(options, progress)
        values = observer.newest() if observer else {}
    if result.died or result.interrupted:
        raise BenchError(f"fleet of {len(scenario.uav_ids)}: interrupted or lost {result.died}")
    share = missed_percent([row for name, row in values.items() if name.startswith("uav")])
    latency = [float(values.get("sim", {}).get(f"latency_{p}_ms", 0.0)) for p in ("p50", "p99")]
    return Flown(rate, share, latency[0], latency[1], _lost(result), sampler.usage())


def _lost(result: FleetResult) -> float:
    """Share of the ticks that one UAV's topics lack in the bag, on average."""
    counts = result.recorded.get("topics", {})
    ticks = counts.get("/clock", 0)
    kept = [count for name, count in counts.items() if name.endswith("/odom")]
    return max(0.0, 100.0 * (1.0 - mean(kept) / ticks)) if ticks else 0.0


def _real_time(case: Case, plan: Plan) -> Iterator[Row]:
    duration_s = plan.of(15.0, 5.0)
    scenario = paper(duration_s) if case.size == 5 else grid(case.size, case.control_hz, duration_s)
    flights: list[Flown] = []
    nodes: list[Usage] = []
    for turn in range(plan.of(2, 1)):
        print_progress(f"real time, {case.name}: {turn + 1}")
        flights.append(fly(scenario, lockstep=False, bag=case.bag, processes=case.processes))
        nodes.append(bare_node(case.control_hz, duration_s))
    missed = [flown.missed_percent for flown in flights]
    yield Row(f"{case.name}: missed ticks", missed, "%", target=_MISSED)
    yield Row(f"{case.name}: latency, median", [flown.latency_p50_ms for flown in flights], "ms")
    yield Row(f"{case.name}: latency, 99 %", [flown.latency_p99_ms for flown in flights], "ms")
    name = f"bare rclpy node at {case.control_hz} Hz"
    for role in ("uav", "sim", "recorder") if case.bag else ("uav", "sim"):
        for what, unit, figure in (("CPU", "cores", "cores"), ("memory", "MB", "pss_mb")):
            values = [float(getattr(flown.usage[role], figure)) for flown in flights]
            bare = [float(getattr(usage, figure)) for usage in nodes]
            yield Row(f"{case.name}: {what} of {_PROCESS[role]}", values, unit, name, bare)
    if case.size == 5:
        share = [_status_percent(scenario, flown.usage["uav"].cores) for flown in flights]
        yield Row(f"{case.name}: statuses in one UAV's CPU", share, "%", target=_STATUS)
    if case.bag:
        recorder = [100.0 * flown.usage["recorder"].cores / case.size for flown in flights]
        yield Row(f"{case.name}: the recorder, per UAV", recorder, "% of a core", target=_RECORDER)
        lost = [flown.lost_percent for flown in flights]
        yield Row(f"{case.name}: odometry missing in the bag", lost, "%")


def _status_percent(scenario: Scenario, cores: float) -> float:
    """The part of the CPU time of a UAV process, which uses so many `cores`, in which it makes and sends its status."""
    with (
        own_domain() as domain,
        Observer(domain),
        ros_context([]),
        ros_node("uav", "/uav3") as node,
    ):
        uav = UavNode(node, scenario, 3, CommunicationGraph(scenario, FlightOptions()))
        for ear in node.subscriptions:  # as in flight, nothing is missing
            node.create_publisher(ear.msg_type, ear.topic_name, ear.qos_profile)
        uav.flight.take_leg(HeaderFields(time.time_ns(), "form"))
        uav.endpoints.last_word()  # the first one is logged

        def report() -> None:
            time.sleep(0.005)  # other programs run since the last wake-up, as in flight
            uav.endpoints.last_word()

        status_s = cpu_seconds(report, 50)
    return 100.0 * STATUS_HZ * status_s / cores


def _lockstep(plan: Plan) -> Iterator[Row]:
    scenario = paper(plan.of(10.0, 3.0))
    fly_headless(paper(0.1))  # compiled or loaded before it counts
    rates = take_turns(
        {
            "headless": lambda: scenario.timing.ticks / cpu_seconds(lambda: fly_headless(scenario)),
            "": lambda: fly(scenario, lockstep=True, bag=False).steps_per_s,
            ", recorded": lambda: fly(scenario, lockstep=True, bag=True).steps_per_s,
        },
        plan.of(3, 1),
        "lock-step, N = 5",
    )
    for what in ("", ", recorded"):
        name = f"lock-step, N = 5{what}"
        yield Row(name, rates[what], "steps/s", "the headless flight", rates["headless"])
