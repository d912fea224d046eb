"""`ptnsbc node`: one process of a flight, as `ros2 run ptnsbc_nodes` starts it."""

from __future__ import annotations

from importlib import import_module
from typing import Annotated, Literal

import typer

from ptnsbc_tools import ros

SETTINGS = {
    "ignore_unknown_options": True,
    "allow_extra_args": True,
    "allow_interspersed_args": False,
}
"""All arguments after the name belong to the process, --help too."""


def node(
    context: typer.Context,
    name: Annotated[
        Literal["uav", "sim", "recorder", "bridge", "coordinator", "operator", "fleet"],
        typer.Argument(
            metavar="NAME", help="The process; its own options and those of ROS follow."
        ),
    ],
) -> None:
    """Run one process of a flight, for debugging or for a launcher of your own.

    `ptnsbc node uav --help` lists its options. `ros2 run ptnsbc_nodes uav` is the same.
    """
    from ptnsbc_nodes.fleet.child_process import EXECUTABLES

    modules = {executable: module for module, executable in EXECUTABLES.items()}
    with ros.required():
        module = import_module(modules[name])
    raise typer.Exit(module.main(context.args))
