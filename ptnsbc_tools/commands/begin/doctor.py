"""`ptnsbc doctor`: whether this computer can fly, and how to mend it."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import typer

from ptnsbc_tools import console, options

_LACKING = 1


def doctor(
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="[SCENARIO]", help="Look at the ports of this scenario's bridges too."
        ),
    ] = None,
    json: options.JsonOption = False,
) -> None:
    """Examine this computer: middleware, discovery, clock, cores, cache, disk, ports.

    Exit code 0: flights are possible, whatever the warnings are. 1: something must be mended first.
    """
    from ptnsbc_tools.check import ERROR
    from ptnsbc_tools.doctor import examine
    from ptnsbc_tools.tables import findings_table

    chosen = None if scenario is None else options.scenario_with(scenario, {})
    found = examine(chosen)
    if json:
        console.print_json({"findings": [dataclasses.asdict(one) for one in found]})
    else:
        console.out().print(findings_table("This computer", found))
    if any(one.severity == ERROR for one in found):
        raise typer.Exit(_LACKING)
