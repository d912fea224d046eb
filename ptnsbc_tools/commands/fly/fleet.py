"""`ptnsbc fleet`: one ROS 2 process per UAV, recorded, and the verdict from the bag."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.signals import restore_handlers
from ptnsbc_tools import console, options, ros
from ptnsbc_tools.commands.begin.check import preflight

if TYPE_CHECKING:
    from ptnsbc_nodes.fleet.fleet import FleetOptions, FleetResult
    from ptnsbc_sim.scenario import Scenario

_NO_VERDICT = 1


def fleet(
    context: typer.Context,
    scenario: options.ScenarioArgument,
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep/--real-time",
            help="As fast as possible, with the same bytes every time, or by the wall clock.",
        ),
    ] = False,
    backend: Annotated[
        Literal["sim", "mavlink"],
        typer.Option("--backend", help="The simulator, or a MAVLink bridge per flight controller."),
    ] = "sim",
    allow_arming: options.AllowArmingOption = False,
    only: Annotated[
        str,
        typer.Option(
            "--only",
            metavar="PROCESSES",
            help="Start only these processes on this host, and the others elsewhere: recorder,sim,1,2. "
            "The host that runs the recorder waits for all other hosts, starts the flight and ends it.",
        ),
    ] = "",
    processes: Annotated[
        int | None,
        typer.Option(
            "--processes",
            min=1,
            metavar="K",
            help="Fly the simulated UAVs in K processes instead of one for each: for large fleets.",
        ),
    ] = None,
    network: options.NetworkOption = None,
    domain: options.DomainOption = None,
    namespace: options.NamespaceOption = "",
    plant: options.PlantOption = None,
    task: options.TaskOption = None,
    profile: options.ProfileOption = None,
    avoidance: options.AvoidanceOption = None,
    seed: options.SeedOption = None,
    duration: options.DurationOption = None,
    settings: options.SetOption = None,
    mission: options.MissionOption = None,
    params_file: options.ParamsFileOption = None,
    check: Annotated[
        bool | None,
        typer.Option(
            "--check/--no-check",
            help="Fly dry runs before anything starts, and from the measured positions before anything arms and before "
            "the flight. Default: with real vehicles.",
        ),
    ] = None,
    view: Annotated[
        bool,
        typer.Option("--view", help="Serve a page with the flight live, and print its address."),
    ] = False,
    foxglove: options.FoxgloveOption = None,
    plain: options.PlainOption = False,
    operator: Annotated[
        bool,
        typer.Option(
            "--operator",
            help="Offer the fleet in the types of ptnsbc_interfaces: its state, actions and services.",
        ),
    ] = False,
    wait: Annotated[
        bool,
        typer.Option(
            "--wait",
            help="Leave arming (`ptnsbc mission arm`) and the start (`ptnsbc mission start 1`) to an operator.",
        ),
    ] = False,
    bag: options.BagOption = None,
    overwrite: options.OverwriteOption = False,
    json: options.JsonOption = False,
) -> None:
    """Fly a scenario with one ROS 2 process per UAV; ends with the verdict.

    The vehicles are simulated, or real flight controllers (--backend mavlink). Nothing leaves this
    host without --network.
    """
    ros.select_network(network, domain)
    names = (
        "lockstep",
        "backend",
        "allow_arming",
        "only",
        "processes",
        "namespace",
        "bag",
        "overwrite",
        "check",
        "operator",
        "wait",
    )
    given = {name: context.params[name] for name in names}
    given["namespace"] = options.full_namespace(namespace)
    given["shown"] = Shown(view, foxglove, table=not (plain or json) and sys.stdout.isatty())
    raise typer.Exit(fly_and_judge(options.chosen(context), json, **given))


class Shown(NamedTuple):
    """The views of a flight while it is flown."""

    page: bool = False
    foxglove: int | None = None  # port
    table: bool = False  # in the terminal


_NOT_SHOWN = Shown()


def fly_and_judge(
    scenario: Scenario,
    json: bool,
    picture: Path | None = None,
    *,
    backend: Literal["sim", "mavlink"] = "sim",
    only: str = "",
    bag: Path | None = None,
    check: bool | None = None,
    shown: Shown = _NOT_SHOWN,
    **given: Any,
) -> int:
    """Fly with one process per UAV and judge the bag; returns the exit code.

    Args:
        scenario: the scenario to fly.
        json: print the verdict as JSON.
        picture: PNG to draw.
        backend: the simulator or flight controllers.
        only: processes of this host, all when empty.
        bag: folder to record into, a temporary one by default.
        check: fly dry runs first, and refuse what they refuse; None: with flight controllers.
        shown: while it is flown.
        given: further fields of `FleetOptions`.
    """
    if backend == "mavlink":
        for line in _flight_overrides(scenario):
            console.say(line)
        scenario = scenario.bridged()
    preflight(scenario, quiet=json)
    with ros.required(f"{ros.INSTALL}, or fly without it: ptnsbc simulate"):
        from ptnsbc_nodes.fleet.fleet import FleetOptions, chosen
    here = chosen(only, scenario, backend) if only else frozenset()
    request = FleetOptions(scenario, backend=backend, bag=bag, only=here, **given)
    if request.leads and (backend == "mavlink" if check is None else check):
        request = _checked(request)
    if not request.leads:
        return _show_part(_fly(request, shown), json=json)
    with ExitStack() as stack:
        if bag is None:  # the verdict is read from a bag
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="ptnsbc-"))
            request = replace(request, bag=Path(folder) / "bag")
        flown = _fly(request, shown)
        for line in _losses(flown):
            console.say(line)
        assert request.bag is not None
        if flown.interrupted and not request.bag.exists():
            return flown.exit_code
        return _judge(request.bag, flown, kept=bag, picture=picture, json=json)


def _checked(request: FleetOptions) -> FleetOptions:
    """The request with the check of the measured positions, after the dry runs from those of the file.

    Raises:
        CheckError: the dry runs refuse the scenario.
    """
    from ptnsbc_tools.check import refuse
    from ptnsbc_tools.library.flying import flown_before

    refuse(request.scenario, flown_before(request.scenario))
    return replace(request, objection=_objection)


def _objection(scenario: Scenario) -> str:
    """The reason why a scenario must not be flown, in a line; empty when it may."""
    from ptnsbc_tools.check import refuse
    from ptnsbc_tools.library.flying import flown_before

    try:
        refuse(scenario, flown_before(scenario))
    except PtnsbcError as error:
        return f"{error}; with --no-check it is flown all the same"
    return ""


def _fly(request: FleetOptions, shown: Shown) -> FleetResult:
    from ptnsbc_nodes.fleet.fleet import run_fleet
    from ptnsbc_tools.live.beside import Viewing
    from ptnsbc_tools.live.dashboard import Dashboard

    dashboard = Dashboard() if shown.table and sys.stderr.isatty() else None
    say = console.say if dashboard is None else dashboard.say
    viewing = Viewing(request.scenario, request.namespace, shown.page, shown.foxglove, dashboard)
    try:
        with dashboard or nullcontext():
            return run_fleet(replace(request, beside=viewing.beside(say)), say)
    finally:
        restore_handlers()


def _flight_overrides(scenario: Scenario) -> Iterator[str]:
    """The changes that real vehicles make to a scenario, one line each."""
    for key, value in scenario.mavlink.overrides.items():
        own: Any = scenario
        for name in key.split("."):
            own = getattr(own, name, None)
        before = "the default" if own is None else own
        yield f"in flight: {key}: {value} instead of {before} (mavlink.overrides)"


def _fleet_facts(flown: FleetResult) -> dict[str, Any]:
    """The results of the processes, which the verdict does not have."""
    return {
        "startup_s": round(flown.startup_s, 3),
        "flight_s": round(flown.flight_s, 3),
        "died": list(flown.died),
        "killed": list(flown.killed),
        "interrupted": flown.interrupted,
        "recorded": {key: flown.recorded.get(key) for key in ("messages", "late", "lost")},
        "logs": str(flown.processes[0].log.parent) if flown.processes else None,
    }


def _ends(flown: FleetResult) -> Iterator[str]:
    """The processes that ended in flight, one line each."""
    for name in flown.died:
        yield f"{name} ended before its time"
    for name in flown.killed:
        yield f"{name} was killed, as the scenario has it"


def _losses(flown: FleetResult) -> Iterator[str]:
    """The defects of the flight and its recording, one line each."""
    yield from _ends(flown)
    recorded = flown.recorded
    if not recorded:
        yield "the recorder left no count of its messages: the bag may be cut"
    if recorded.get("late"):
        yield f"{recorded['late']} messages came too late to be sorted: bytes differ between runs"
    if recorded.get("lost"):
        yield f"{recorded['lost']} messages did not reach the recorder: {recorded['messages']} are in the bag"


def _judge(
    bag: Path, flown: FleetResult, *, kept: Path | None, picture: Path | None, json: bool
) -> int:
    """Judge the bag and show the verdict; when the bag cannot be read, show how the flight ended."""
    from ptnsbc_sim.verdict import verdict_on
    from ptnsbc_tools.reading.bag_reader import read_recording
    from ptnsbc_tools.tables import show_verdict

    facts = _fleet_facts(flown)
    try:
        recording = read_recording(bag)
        verdict = verdict_on(recording)
    except PtnsbcError as error:
        line = " ".join(str(error).split())
        end = "was interrupted" if flown.interrupted else "is over"
        console.say(
            f"error: the flight {end} after {flown.flight_s:.1f} s, but has no verdict: {line}"
        )
        if json:
            place = None if kept is None else str(kept)
            console.print_json({"bag": place, "fleet": facts, "verdict": None, "error": line})
        return flown.exit_code or _NO_VERDICT
    if picture is not None:
        from ptnsbc_tools.plotting.draw import draw_flight

        draw_flight(recording, picture)
    show_verdict(verdict, json=json, bag=kept, fleet=facts, picture=picture)
    return flown.exit_code or verdict.exit_code


def _show_part(flown: FleetResult, *, json: bool) -> int:
    """Show how a part of the fleet ended; the host with the recorder shows the verdict."""
    for line in _ends(flown):
        console.say(line)
    console.say(f"over after {flown.flight_s:.1f} s; the verdict is on the host with the recorder")
    if json:
        facts = _fleet_facts(flown)
        del facts["recorded"]
        console.print_json({"fleet": facts})
    return flown.exit_code
