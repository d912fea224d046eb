"""A ROS parameter file from a scenario."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import options
from ptnsbc_tools.options import ScenarioArgument, SetOption


class ParamsError(PtnsbcError):
    """A file that cannot be written."""


def params(
    scenario: ScenarioArgument,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="Write into this file, not to stdout."),
    ] = None,
    settings: SetOption = None,
) -> None:
    """Print a scenario as ROS parameters: one file for every node of the fleet, on any computer.

    For `ros2 launch ptnsbc_bringup uav.launch.py params:=FILE`, or after --ros-args --params-file.
    """
    from ptnsbc_nodes.runtime.scenario_parameters import parameter_file

    text = parameter_file(options.scenario_with(scenario, options.overrides(settings=settings)))
    if out is None:
        sys.stdout.write(text)
        return
    beside = out.with_name(f"{out.name}.part")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(out)
    except OSError as error:
        raise ParamsError(f"--out {out}: {error.strerror}: expected a file to write") from None
