"""`ptnsbc key`: the secret key of a fleet with `security: signed`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ptnsbc_tools import console, ros


def key(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE]",
            help="Where to write it. Default: PTNSBC_FLEET_KEY, or ptnsbc/fleet.key in the folder for settings.",
        ),
    ] = None,
) -> None:
    """Write a new key for `security: signed`; copy it to every computer of the fleet."""
    with ros.required("install the extra [ros] or source ROS 2"):
        from ptnsbc_nodes.comm.seal import key_file, new_key
    path = file or key_file()
    new_key(path)
    console.say(f"key: {path}")
