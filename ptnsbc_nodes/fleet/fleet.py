"""A whole flight, or the part of it that this computer flies: one process per UAV, the sim, the recorder."""

from __future__ import annotations

import json
import os
import signal
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace

from ptnsbc_io.bag.writer import check_replaceable
from ptnsbc_io.files import replacing
from ptnsbc_nodes.comm.seal import seal_of
from ptnsbc_nodes.comm.topics import LAUNCHER, RECORDER
from ptnsbc_nodes.emergency import forget_dead, list_fleet, release, runtime_folder
from ptnsbc_nodes.fleet.child_process import (
    BRIDGE,
    ChildProcess,
    Crew,
    FleetOptions,
    ProcessCommand,
    chosen,
    commands,
    groups,
    names,
)
from ptnsbc_nodes.fleet.fault_injector import FaultInjector
from ptnsbc_nodes.fleet.fleet_node import LauncherNode
from ptnsbc_nodes.fleet.supervisor import Supervisor
from ptnsbc_nodes.fleet.takeoff import FleetError, Launch, Report, TakeOff
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.environment import reserved_domain
from ptnsbc_nodes.runtime.signals import StopRequest
from ptnsbc_nodes.runtime.warmup import load_fleet, load_world
from ptnsbc_sim.plugins.uav_plugins import UavPlugins
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.fault_rules import PROCESS

__all__ = ["FleetError", "FleetOptions", "FleetResult", "chosen", "prepare", "run_fleet"]

_DIED, _INTERRUPTED = 1, 130
_EPOCH_S = 0.5  # from the call of the leader to the epoch


@dataclass(frozen=True)
class FleetResult:
    """A flight that has ended, in whatever way."""

    processes: Sequence[ChildProcess]
    died: tuple[str, ...]  # processes that ended before their time
    killed: tuple[str, ...]  # processes of UAVs that ended by a fault of the scenario
    interrupted: bool  # by a signal
    bag: Path | None
    # The recorder's summary; empty when it was killed before it had one.
    recorded: Mapping[str, Any]
    startup_s: float  # wall time
    flight_s: float  # wall time

    @property
    def losses(self) -> str:
        """The processes that have ended before their time, in words; empty when none has."""
        again = {child.name for child in self.processes if child.life > 1}
        return ", ".join(f"{name} (replaced)" if name in again else name for name in self.died)

    @property
    def exit_code(self) -> int:
        """0, or 1 when a process died, or 130 when interrupted."""
        return _DIED if self.died else _INTERRUPTED if self.interrupted else 0


def run_fleet(options: FleetOptions, progress: Report = lambda line: None) -> FleetResult:
    """Fly; `progress` gets a line now and then, and so does `fleet.log` among the logs.

    SIGINT, SIGTERM and SIGHUP end the flight in order, the recorder last. Call it from the main thread: the
    processes end with the thread that started them.

    Raises:
        FleetError: the options do not go together, or the fleet does not get ready.
        BagError: the bag cannot take the place of what is there.
    """
    prepare(options)
    log_dir = Path(options.log_dir or tempfile.mkdtemp(prefix="ptnsbc-")).resolve()
    scenario_file = log_dir / "scenario.yaml"
    with replacing(scenario_file, folder=True) as part:
        part.write_text(options.scenario.text, encoding="utf-8")
    processes = commands(options, scenario_file)

    def say(line: str) -> None:
        # Also where a terminal that is closed cannot take it away.
        with suppress(OSError), (log_dir / "fleet.log").open("a", encoding="utf-8") as log:
            print(line, file=log)
        progress(line)

    # With this launcher. Where other computers fly the rest, there is a launcher for each process at most.
    everywhere = 2 * len(names(options.scenario, options.backend))
    count = everywhere if options.shared else len(processes) + 1
    with StopRequest() as stop, reserved_domain() as domain, ExitStack() as stack:
        settings = environment.for_children(domain, count, log_dir)
        say(f"domain {domain}, logs in {log_dir}")
        stack.enter_context(_listed(options, domain, say))
        if options.beside is not None:
            stack.enter_context(options.beside(settings, scenario_file))
        node = stack.enter_context(
            LauncherNode(
                domain,
                # Launchers on other computers have other names.
                LAUNCHER if options.leads else f"{LAUNCHER}_{min(options.only)}",
                options.namespace,
                seal=seal_of(options.scenario),
                shared=options.shared,
                leads=options.leads,
            )
        )
        crew = Crew(settings, log_dir)
        return _fly(Launch(options, crew, node, stop, say), processes)


def prepare(options: FleetOptions) -> None:
    """Check the options, and compile or load the laws: a dozen processes would compile them side by side."""
    if options.bag is not None:
        check_replaceable(options.bag, overwrite=options.overwrite)
    check_options(options)
    load_fleet(options.scenario)
    for uav in options.scenario.uav_ids[:2]:  # one of these is a follower
        UavPlugins.of(options.scenario, uav)
    if not options.bridged:
        load_world(options.scenario)


def _fly(launch: Launch, processes: Sequence[ProcessCommand]) -> FleetResult:
    options, crew, node, stop, progress = launch
    faults = FaultInjector(options, progress, crew.start_again)
    supervisor = Supervisor(launch, faults)
    began = time.monotonic()
    try:
        TakeOff(launch).run(processes, began + options.patience_s)
        took_off = time.monotonic()
        if options.leads and not stop.came:
            faults.begin(took_off + (node.leader.begins_in_s() or _EPOCH_S))
        supervisor.watch(options.scenario.timing.duration_s)
        landed = time.monotonic()
    finally:
        supervisor.end()
    killed = _killed_by(options.scenario, supervisor.died)
    died = (*(child.name for child in supervisor.died), *supervisor.lost_elsewhere)
    summaries = [child.reports.summary for child in crew.children if child.name == RECORDER]
    return FleetResult(
        processes=crew.children,
        died=tuple(dict.fromkeys(name for name in died if name not in killed)),
        killed=killed,
        interrupted=stop.came,
        bag=options.bag,
        recorded=json.loads(summaries[0]) if summaries and summaries[0] else {},
        startup_s=took_off - began,
        flight_s=landed - took_off,
    )


def _killed_by(scenario: Scenario, ended: Sequence[ChildProcess]) -> tuple[str, ...]:
    """The processes that have ended because a fault of the scenario kills a UAV: no defect of the fleet.

    They are its own process and its bridge, which lands the vehicle of a UAV that stays away.
    """
    victims = {one.victim for one in scenario.faults if one.kind in ("kill", "restart")}
    struck = (one for one in ended if one.command.uavs)
    return tuple(
        one.name
        for one in struck
        if (one.name in victims and one.exit_code == -signal.SIGKILL)
        or (
            one.command.module == BRIDGE
            and victims.intersection(one.command.lost)
            and one.exit_code == _DIED
        )
    )


@contextmanager
def _listed(options: FleetOptions, domain: int, progress: Report) -> Iterator[None]:
    """Inside the `with` `ptnsbc stop` knows all bridges of this flight; an order of an earlier flight is released."""
    if not options.bridged:
        yield
        return
    folder = runtime_folder(domain, options.namespace)
    held = release(folder)
    if held.what:
        progress(f"the order {held.text!r} of an earlier flight is released")
    forget_dead(folder)
    list_fleet(folder, [f"bridge{i}" for i in options.scenario.uav_ids])
    try:
        yield
    finally:
        list_fleet(folder, [])


def check_options(options: FleetOptions) -> None:
    """FleetError when the options do not go together."""
    for objection in _objections(options):
        raise FleetError(objection)


def _objections(options: FleetOptions) -> Iterator[str]:
    """The options that do not go together, and the way out."""
    bridged, shared, backend = options.bridged, options.shared, f"--backend {options.backend}"
    if options.namespace:
        try:
            validate_namespace(options.namespace)
        except InvalidNamespaceException as error:
            yield f"--namespace {options.namespace}: {' '.join(str(error).split())}"
    if options.bag is not None and not options.leads:
        only = ",".join(sorted(options.only))
        yield (
            f"--bag {options.bag}: the recorder is not among --only {only}: expected it there, or no --bag on this "
            "computer"
        )
    if shared and "ROS_DOMAIN_ID" not in os.environ:
        yield (
            "--only: the computers of a fleet find each other in one domain: expected --domain N, the same on all of "
            "them, or ROS_DOMAIN_ID"
        )
    yield from _objections_to_processes(options)
    if bridged and options.wait and shared:
        yield (
            "--wait: a launcher keeps the vehicles of its own computer from arming, not those of others: expected no "
            f"--only with {backend}"
        )
    if bridged and options.lockstep:
        yield "--lockstep: real vehicles do not wait for messages: expected --backend sim, or no --lockstep"
    if bridged and not options.allow_arming:
        yield (
            f"{backend} arms and flies vehicles: expected --allow-arming; to look at a vehicle without arming "
            "it: ptnsbc bridge"
        )


def _objections_to_processes(options: FleetOptions) -> Iterator[str]:
    """Reasons why UAVs that are to share a process must have processes of their own."""
    count, most = options.processes, len(options.scenario.uav_ids)
    if count is None or count == most:
        return
    named, without = f"--processes {count}", "expected no --processes"
    if not 1 <= count <= most:
        yield f"{named}: {options.scenario.name} has {most} UAVs: expected 1 to {most}"
    if options.bridged or options.shared:
        other = "--only" if options.shared else f"--backend {options.backend}"
        yield f"{named}: each UAV has a process of its own with {other}: {without}"
    shared = {uav for group in groups(options) if len(group) > 1 for uav in group}
    for fault in options.scenario.faults:
        if fault.rule.strikes == PROCESS and fault.struck_uav in shared:
            yield f"{named}: {fault.text}: it would strike the other UAVs of the process as well: {without}"
