"""`ptnsbc params`: a scenario as a ROS parameter file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ptnsbc_tools import options
from ptnsbc_tools.options import ScenarioArgument, SetOption


def params(
    scenario: ScenarioArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Write into this file and not to stdout.",
        ),
    ] = None,
    settings: SetOption = None,
) -> None:
    """Print a scenario as ROS parameters: one file for every node of the fleet, on any computer.

    For `ros2 launch ptnsbc_bringup uav.launch.py params:=FILE`, or after --ros-args --params-file.
    """
    from ptnsbc_nodes.runtime.scenario_parameters import parameter_file
    from ptnsbc_tools.files import replacing

    text = parameter_file(options.scenario_with(scenario, options.overrides(settings=settings)))
    if out is None:
        sys.stdout.write(text)
        return
    with replacing(out) as part:
        part.write_text(text, encoding="utf-8")
