"""`ptnsbc demo`: Simulation 1 of the paper, flown by a fleet."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from ptnsbc_tools import options
from ptnsbc_tools.commands.fly.fleet import fly_and_judge

_SCENARIO = "paper_5"


def demo(
    duration: options.DurationOption = None,
    folder: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="DIR", help="Folder for the bag and the picture."),
    ] = Path("out"),
    json: options.JsonOption = False,
) -> None:
    """Fly Simulation 1 of the paper with a fleet in lock-step: bag, verdict and picture."""
    scenario = options.scenario_with(_SCENARIO, options.overrides(duration=duration))
    bag = folder / f"demo-{datetime.now():%Y%m%d-%H%M%S}"
    picture = bag.with_name(f"{bag.name}.png")
    raise typer.Exit(fly_and_judge(scenario, json, picture, lockstep=True, bag=bag))
