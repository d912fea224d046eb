"""`ptnsbc fleet`: one ROS 2 process per UAV, recorded, and the verdict from the bag; `ptnsbc demo`: one of them."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.signals import restore_handlers
from ptnsbc_tools import console, ros
from ptnsbc_tools.commands.check import preflight
from ptnsbc_tools.options import (
    AllowArmingOption,
    BagOption,
    DomainOption,
    DurationOption,
    FlightChoices,
    NamespaceOption,
    OverwriteOption,
    PlainOption,
    ScenarioArgument,
    Showing,
    option,
)

if TYPE_CHECKING:
    from ptnsbc_nodes.fleet.fleet import FleetOptions, FleetResult
    from ptnsbc_sim.scenario import Scenario
    from ptnsbc_tools.live.dashboard import Viewer

_DEMO = "paper_5"
_NO_VERDICT = 1


@dataclass(frozen=True)
class Parts:
    """Options of the fleet: vehicles, and the place of its processes."""

    lockstep: Annotated[
        bool,
        option(
            "--lockstep/--real-time",
            "As fast as possible, with the same bytes every time, or by the wall clock.",
        ),
    ] = False
    backend: Annotated[
        Literal["sim", "mavlink", "ros"],
        option(
            "--backend",
            "The simulator, or a bridge per vehicle: of MAVLink, or of topics of ROS 2.",
        ),
    ] = "sim"
    allow_arming: AllowArmingOption = False
    only: Annotated[
        str,
        option(
            "--only PROCESSES",
            "Start only these processes on this host, and the others elsewhere: recorder,sim,1,2. "
            "The host that runs the recorder waits for all other hosts, starts the flight and ends it.",
        ),
    ] = ""
    processes: Annotated[
        int | None,
        option(
            "--processes K",
            "Fly the simulated UAVs in K processes instead of one for each: for large fleets.",
            1,
        ),
    ] = None
    namespace: NamespaceOption = ""
    wait: Annotated[
        bool,
        option(
            "--wait",
            "Leave arming (`ptnsbc mission arm`) and the start (`ptnsbc mission start 1`) to an operator.",
        ),
    ] = False
    bag: BagOption = None
    overwrite: OverwriteOption = False

    def request(self, scenario: Scenario) -> FleetOptions:
        """The request to the launcher."""
        from ptnsbc_nodes.fleet.fleet import FleetOptions, chosen

        fields = {**vars(self), "only": frozenset[str]()}
        if self.only:
            fields["only"] = chosen(self.only, scenario, self.backend)
        return FleetOptions(scenario, **fields)


@dataclass(frozen=True)
class Views:
    """The views of a flight while it is flown."""

    view: Annotated[
        bool, option("--view", "Serve a page with the flight live, and print its address.")
    ] = False
    plain: PlainOption = False


def fleet(
    scenario: ScenarioArgument,
    parts: Parts,
    choices: FlightChoices,
    views: Views,
    domain: DomainOption = None,
    port_base: Annotated[
        int | None,
        option("--port-base", "Hear vehicle i, from 0, on this port + i of 127.0.0.1.", 1, 61000),
    ] = None,
    check: Annotated[
        bool | None,
        option(
            "--check/--no-check",
            "Fly dry runs before anything starts; of real vehicles from where they stand, before anything arms. "
            "Default: with real vehicles.",
        ),
    ] = None,
    *,
    showing: Showing,
) -> None:
    """Fly a scenario with one ROS 2 process per UAV, and judge it.

    The vehicles are simulated, or real ones (--backend mavlink, ros). Nothing leaves this
    host without ROS_STATIC_PEERS.
    """
    if domain is not None:
        os.environ["ROS_DOMAIN_ID"] = str(domain)  # child processes inherit it
    chosen = choices.of(scenario)
    if port_base is not None:
        ports = enumerate(chosen.uav_ids, port_base)
        chosen = chosen.with_(
            {f"mavlink.vehicles.{uav}.connect": f"udpin:127.0.0.1:{port}" for port, uav in ports}
        )
    raise typer.Exit(fly_and_judge(chosen, parts, showing, check=check, views=views))


def demo(
    duration: DurationOption = None,
    folder: Annotated[
        Path, option("--output -o DIR", "Folder for the bag and the picture.")
    ] = Path("out"),
    *,
    showing: Showing,
) -> None:
    """Fly Simulation 1 of the paper with a fleet in lock-step: bag, verdict and picture."""
    scenario = FlightChoices(duration=duration).of(_DEMO)
    bag = folder / f"demo-{datetime.now():%Y%m%d-%H%M%S}"
    picture = bag.with_name(f"{bag.name}.png")
    parts = Parts(lockstep=True, bag=bag)
    raise typer.Exit(fly_and_judge(scenario, parts, showing, picture=picture))


def fly_and_judge(
    scenario: Scenario,
    parts: Parts,
    showing: Showing,
    *,
    picture: Path | None = None,
    check: bool | None = None,
    views: Views | None = None,
) -> int:
    """Fly with one process per UAV and judge the bag; returns the exit code.

    Without a bag in `parts` the recording is temporary. `check` flies dry runs, and refuses what they refuse;
    None does so with flight controllers. `picture` is a PNG to draw.
    """
    bridged = parts.backend != "sim"
    if bridged:
        for line in _flight_overrides(scenario):
            console.say(line)
        scenario = scenario.bridged(ros=parts.backend == "ros")
    preflight(scenario, quiet=showing.json)
    with ros.required(f"{ros.INSTALL}, or fly without it: ptnsbc simulate"):
        from ptnsbc_nodes.fleet.fleet import prepare

        request = parts.request(scenario)
    with console.compiling():
        prepare(request)  # what it refuses needs no dry run
    if request.leads and (bridged if check is None else check):
        from ptnsbc_tools.check import dry_run

        if not bridged or request.shared:  # other computers may arm before the vehicles are known
            dry_run.flown(scenario).refuse()
        request = replace(request, objection=_objection)
    with ExitStack() as stack:
        viewer = _viewer(request, views, showing.json)
        stack.callback(viewer.end)
        if request.leads and request.bag is None:  # the verdict is read from a bag
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="ptnsbc-"))
            request = replace(request, bag=Path(folder) / "bag")
        flown = _fly(request, viewer)
        for line in _losses(flown, leads=request.leads):
            console.say(line)
        if not request.leads:  # the host with the recorder shows the verdict
            end = f"over after {flown.flight_s:.1f} s"
            console.say(f"{end}; the verdict is on the host with the recorder")
            if showing.json:
                facts = _fleet_facts(flown)
                del facts["recorded"]
                console.print_json({"fleet": facts})
            return flown.exit_code
        assert request.bag is not None
        if flown.interrupted and not request.bag.exists():
            return flown.exit_code
        return _judge(request.bag, flown, showing, viewer, kept=parts.bag, picture=picture)


def _objection(scenario: Scenario) -> str:
    """The reason why a scenario must not be flown, in a line; empty when it may."""
    from ptnsbc_tools.check.dry_run import flown

    try:
        flown(scenario).refuse()
    except PtnsbcError as error:
        return f"{error}; with --no-check it is flown all the same"
    return ""


def _viewer(request: FleetOptions, views: Views | None, json: bool) -> Viewer:
    """The view of the flight; it begins with the flight when one is asked for."""
    from ptnsbc_tools.live.dashboard import Dashboard, Viewer

    views, terminal = views or Views(plain=True), sys.stdout.isatty() and sys.stderr.isatty()
    dashboard = Dashboard() if terminal and not (views.plain or json) else None
    words = ["--namespace", request.namespace] if request.namespace else []
    words += [] if views.view else ["--no-page"]
    wanted = views.view or dashboard is not None
    return Viewer(words if wanted else None, request.scenario, dashboard)


def _fly(request: FleetOptions, viewer: Viewer) -> FleetResult:
    from ptnsbc_nodes.fleet.fleet import run_fleet

    try:
        with viewer.dashboard or nullcontext():
            return run_fleet(replace(request, beside=viewer.beside), viewer.say)
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
        "recorded": {
            key: flown.recorded.get(key) for key in ("messages", "late", "lost", "refused")
        },
        "logs": str(flown.processes[0].log.parent) if flown.processes else None,
    }


def _losses(flown: FleetResult, *, leads: bool) -> Iterator[str]:
    """The defects of the flight, and of its recording on the host that leads, one line each."""
    if flown.died:
        yield f"{flown.losses}: ended early, or with a fault"
    for name in flown.killed:
        yield f"{name} was killed, as the scenario has it"
    if not leads:
        return
    recorded = flown.recorded
    if not recorded:
        yield "the recorder left no count of its messages: the bag may be cut"
    if recorded.get("late"):
        yield f"{recorded['late']} messages came too late to be sorted: bytes differ between runs"
    if recorded.get("lost"):
        yield f"{recorded['lost']} messages did not reach the recorder: {recorded['messages']} are in the bag"
    if recorded.get("refused"):
        yield f"recorder: {recorded['refused']}"


def _judge(
    bag: Path,
    flown: FleetResult,
    showing: Showing,
    viewer: Viewer,
    *,
    kept: Path | None,
    picture: Path | None,
) -> int:
    """Judge the bag and show the verdict; when the bag cannot be read, show how the flight ended."""
    from ptnsbc_tools.library.flight import flight_in
    from ptnsbc_tools.tables import show_verdict, verdict_sentence

    facts = _fleet_facts(flown)
    try:
        flight = flight_in(bag)
        verdict = flight.verdict
    except PtnsbcError as error:
        line = " ".join(str(error).split())
        end = "was interrupted" if flown.interrupted else "is over"
        console.say(
            f"error: the flight {end} after {flown.flight_s:.1f} s, but has no verdict: {line}"
        )
        if showing.json:
            place = None if kept is None else str(kept)
            console.print_json({"bag": place, "fleet": facts, "verdict": None, "error": line})
        return flown.exit_code or _NO_VERDICT
    if picture is not None:
        flight.save_picture(picture)
    code = show_verdict(verdict, showing, bag=kept, fleet=facts, picture=picture)
    line = verdict_sentence(verdict).plain.removeprefix(f"Verdict: {verdict.verdict}. ")
    viewer.end({"verdict": verdict.verdict, "line": line, "bag": str(bag), "kept": bool(kept)})
    return flown.exit_code or code
