"""`ptnsbc network`: a fleet on several computers: key, single processes."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import typer

from ptnsbc_tools import console, ros
from ptnsbc_tools.options import argument, group

network = group("A fleet on several computers: key, single processes.")


@network.command(
    # All words after the name of a process are its own, --help too.
    context_settings={
        "ignore_unknown_options": True,
        "allow_extra_args": True,
        "allow_interspersed_args": False,
    }
)
def node(
    context: typer.Context,
    name: Annotated[
        Literal["uav", "sim", "recorder", "bridge", "coordinator"],
        argument("NAME", "The process; its own options and those of ROS follow."),
    ],
) -> None:
    """Run one process of a flight, for debugging or for a launcher of your own.

    `ptnsbc network node uav --help` lists its options. `ros2 run ptnsbc_nodes uav` is the same.
    """
    from ptnsbc_nodes.fleet.child_process import EXECUTABLES

    modules = {executable: module for module, executable in EXECUTABLES.items()}
    with ros.required():
        module = import_module(modules[name])
    raise typer.Exit(module.main(context.args))


@network.command()
def key(
    file: Annotated[
        Path | None,
        argument(
            "[FILE]",
            "Where to write it. Default: PTNSBC_FLEET_KEY, or ptnsbc/fleet.key in the folder for settings.",
        ),
    ] = None,
) -> None:
    """Write a new key for `security: signed`; copy it to every computer of the fleet."""
    with ros.required():
        from ptnsbc_nodes.comm.seal import key_file, new_key
    path = file or key_file()
    new_key(path)
    console.say(f"key: {path}")
