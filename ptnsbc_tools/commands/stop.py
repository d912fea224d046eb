"""`ptnsbc stop`: land a flying fleet, from any terminal."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console

_SERVICE_S = 3.0
_BRIDGES_S = 3.0
_HIGHEST_DOMAIN = 232


class StopError(PtnsbcError):
    """No process of a fleet answered."""


def stop(
    kill: Annotated[
        bool, typer.Option("--kill", help="Stop all motors at once; vehicles in the air fall.")
    ] = False,
    domain: Annotated[
        int | None,
        typer.Option(
            "--domain",
            min=0,
            max=_HIGHEST_DOMAIN,
            help="ROS domain that the fleet printed. Default: ROS_DOMAIN_ID.",
        ),
    ] = None,
) -> None:
    """Land every vehicle of a flying fleet, through its leader and through every bridge directly."""
    from ptnsbc_nodes.runtime import environment

    environment.prepare()
    from ptnsbc_nodes.fleet.coordinator_node import Coordinator

    number = int(os.environ.get("ROS_DOMAIN_ID", "0")) if domain is None else domain
    with Coordinator(number) as coordinator:
        # Bridges first: an emergency stop must not wait for a leader that hangs.
        bridges = coordinator.emergency("kill" if kill else "land", _BRIDGES_S)
        refusal = coordinator.call("stop", _SERVICE_S)
    if refusal is not None and not bridges:
        raise StopError(
            f"domain {number}: no bridge listens, and {refusal}: expected a fleet there"
        )
    done = "motors stop" if kill else "landing"
    told = "bridges and leader" if bridges and not refusal else "bridges" if bridges else "leader"
    console.say(f"{done}: {told} told")
