"""`ptnsbc new`: a scenario file to begin with; `ptnsbc scenarios`: those that are there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console
from ptnsbc_tools.options import JsonOption, argument, option


def new(
    file: Annotated[Path, argument("NAME", "Name of the scenario, or its file: NAME.yaml.")],
    shape: Annotated[
        str, option("--shape SHAPE", "v, line, column, grid, circle or sphere.")
    ] = "v",
    n: Annotated[int, option("--n -n N", "UAVs with the leader.", 2, 254)] = 5,
    spacing: Annotated[float, option("--spacing M", "Distance of neighbours.", 1.0)] = 2.0,
    overwrite: Annotated[bool, option("--overwrite", "Replace an existing file.")] = False,
) -> None:
    """Write a commented scenario of so many UAVs, ready to check and fly."""
    from ptnsbc_tools.library import new_scenario

    path = new_scenario.new(file, shape, n, spacing, overwrite=overwrite)
    console.show(str(path))
    console.say(f"next: ptnsbc check {path}")


def scenarios(json: JsonOption = False) -> None:
    """List the scenarios that can be given by name: UAVs, task, length, description."""
    from rich.table import Table

    from ptnsbc_sim.scenario import available, load_scenario
    from ptnsbc_sim.scenario.reading.reader import find

    rows: list[dict[str, Any]] = []
    for name in available():
        entry = {"name": name, "file": str(find(name))}
        try:
            one = load_scenario(name)
        except PtnsbcError as error:
            rows.append({**entry, "error": str(error)})
            continue
        task = one.formation.task
        flight = {"uavs": len(one.uav_ids), "task": task, "duration_s": one.timing.duration_s}
        rows.append({**entry, **flight, "description": one.description})
    if json:
        console.print_json({"scenarios": rows})
        return
    table = Table("name", "UAVs", "task", "s", "description")
    for row in rows:
        about = row.get("description", row.get("error", ""))
        cells = (row.get("uavs", "-"), row.get("task", "-"), f"{row.get('duration_s', 0):g}")
        table.add_row(str(row["name"]), *map(str, cells), str(about))
    console.out().print(table)
