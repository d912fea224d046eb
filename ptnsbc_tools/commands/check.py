"""Before a flight: `ptnsbc new` and `scenarios`, `ptnsbc check` by closed forms and dry runs, `ptnsbc doctor`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console
from ptnsbc_tools.limits import DRY_RUNS, MOST_RUNS
from ptnsbc_tools.options import (
    FlightChoices,
    JsonOption,
    PictureOption,
    ScenarioArgument,
    StrictOption,
    VerboseOption,
    argument,
    option,
    refuse_code,
    scenario_with,
)

if TYPE_CHECKING:
    from ptnsbc_sim.scenario import Scenario

_LACKING = 1


def check(
    scenario: ScenarioArgument,
    choices: FlightChoices,
    backend: Annotated[
        Literal["sim", "mavlink", "ros"],
        option("--backend", "Check what the fleet flies with this backend."),
    ] = "sim",
    fly: Annotated[
        bool,
        option(
            "--fly/--no-fly",
            "Fly dry runs when the rest finds no error; else no code of the scenario runs.",
        ),
    ] = True,
    verbose: VerboseOption = False,
    runs: Annotated[
        int, option("--runs -n N", "Perturbed dry runs; 0: none.", 0, MOST_RUNS)
    ] = DRY_RUNS,
    strict: StrictOption = False,
    picture: PictureOption = None,
    json: JsonOption = False,
) -> None:
    """Check a scenario before anything arms, and fly it in dry runs.

    Closed forms look at graph, shape, spacing, gains, deadline and obstacles. The dry runs fly the scenario in this
    process: once as it stands, then with starts moved at random.
    The scenario is refused when the first of them is not met, or fewer than half of all; with noise, gusts, faults
    or lossy links, fewer than 95 % of all.
    """
    from ptnsbc_tools.check.dry_run import check_report
    from ptnsbc_tools.library import flying
    from ptnsbc_tools.plotting.draw import format_of

    if not fly:
        refuse_code()
    chosen = choices.of(scenario)
    if picture is not None:
        format_of(picture)  # refused before the flights, not after them
    if backend != "sim":
        chosen = chosen.bridged(ros=backend == "ros")
    report = flying.check(chosen, dry_runs=runs if fly else 0, progress=True, strict=strict)
    if json:
        findings = [dataclasses.asdict(finding) for finding in report]
        told = {"scenario": chosen.name, "ok": report.ok, "plan": report.plan}
        console.print_json({**told, "findings": findings})
    else:
        for part in check_report(report, verbose=verbose):
            console.out().print(part)
        same = " with the same options" if choices.keys() or choices.slow else ""
        how = "simulate" if backend == "sim" else f"fleet --backend {backend}"
        if report.ok:
            console.show(f"next: {console.program()} {how} {scenario}{same}")
    if picture is not None and (report.ok or report.flown is not None):
        flying.fly(chosen, checked=False).save_picture(picture)
        console.say(f"picture: {picture}")
    report.refuse()


def preflight(scenario: Scenario, *, quiet: bool, refusing: bool = True) -> None:
    """Check a scenario before a flight: show warnings, and raise on errors where `refusing`."""
    from ptnsbc_tools.check import INFO
    from ptnsbc_tools.library import flying
    from ptnsbc_tools.tables import findings_table

    report = flying.check(scenario, dry_runs=0)
    warnings = [finding for finding in report if finding.severity != INFO]
    if warnings and not quiet:
        console.err().print(findings_table(warnings, brief=True))
    if refusing:
        report.refuse()


def doctor(
    scenario: Annotated[
        str | None, argument("[SCENARIO]", "Look at the ports of this scenario's bridges too.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Examine this computer: middleware, discovery, clock, cores, cache, disk, ports.

    Exit code 0: flights are possible, whatever the warnings are. 1: something must be mended first.
    """
    from ptnsbc_tools.check import ERROR
    from ptnsbc_tools.doctor import examine
    from ptnsbc_tools.tables import findings_table

    refuse_code()
    findings = examine(None if scenario is None else scenario_with(scenario, {}))
    if json:
        console.print_json({"findings": [dataclasses.asdict(finding) for finding in findings]})
    else:
        console.out().print(findings_table(findings))
    if any(finding.severity == ERROR for finding in findings):
        raise typer.Exit(_LACKING)


def new(
    file: Annotated[Path, argument("NAME", "Name of the scenario, or its file: NAME.yaml.")],
    shape: Annotated[
        str, option("--shape SHAPE", "v, line, column, grid, circle or sphere.")
    ] = "v",
    n: Annotated[int, option("--n -n N", "UAVs with the leader.", 2, 254)] = 5,
    spacing: Annotated[float, option("--spacing M", "Distance of neighbours.", 1.0, 100.0)] = 2.0,
    trajectory: Annotated[
        Path | None,
        option(
            "--trajectory FILE", "Path of the leader, such as rows t, x, y, z, yaw; else a circle."
        ),
    ] = None,
    crazyflies: Annotated[
        Path | None,
        option(
            "--crazyflies FILE", "Crazyswarm2's crazyflies.yaml: fly its robots as crazyflie_4."
        ),
    ] = None,
    overwrite: Annotated[bool, option("--overwrite", "Replace an existing file.")] = False,
) -> None:
    """Write a commented scenario, ready to check and fly."""
    from ptnsbc_tools.library import new_scenario

    more: dict[str, Any] = {"trajectory": trajectory, "crazyflies": crazyflies}
    path = new_scenario.new(file, shape, n, spacing, **more, overwrite=overwrite)
    console.show(str(path))
    console.say(f"next: {console.program()} check {path}")


def scenarios(json: JsonOption = False) -> None:
    """List the scenarios that can be given by name: UAVs, task, length, description."""
    from rich.table import Table

    from ptnsbc_sim.scenario import available, load_scenario
    from ptnsbc_sim.scenario.reading.reader import find

    rows: list[dict[str, Any]] = []
    names = available()
    with console.progress("reading scenarios") as advance:
        for done, name in enumerate(names):
            advance(done, len(names))
            row: dict[str, Any] = {"name": name, "file": str(find(name))}
            try:
                one = load_scenario(name)
                row |= {"uavs": len(one.uav_ids), "task": one.formation.task}
                row |= {"duration_s": one.timing.duration_s, "description": one.description}
            except PtnsbcError as error:
                row["error"] = str(error)
            rows.append(row)
    if json:
        console.print_json({"scenarios": rows})
        return
    table = Table("name", "UAVs", "task", "s", "description")
    for row in rows:
        cells = [str(row.get(key, "-")) for key in ("name", "uavs", "task")]
        about = row.get("description", row.get("error", ""))
        table.add_row(*cells, f"{row.get('duration_s', 0):g}", about)
    console.out().print(table)
