"""`ptnsbc bridge`: the MAVLink bridge of one vehicle, until it has landed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ptnsbc_tools import options, ros
from ptnsbc_tools.options import AllowArmingOption, SetOption

_EXAMPLE = "experiment_4"


def bridge(
    uav: Annotated[int, typer.Option("--uav", metavar="N", help="Id of the UAV in the scenario.")],
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="[SCENARIO]", help="Scenario of the fleet, with limits, fence and links."
        ),
    ] = _EXAMPLE,
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect",
            metavar="LINK",
            help="udpin:HOST:PORT, udpout:HOST:PORT or serial:DEVICE[:BAUD]. Default: as in the scenario.",
        ),
    ] = None,
    signing_key: Annotated[
        Path | None,
        typer.Option(
            "--signing-key",
            metavar="FILE",
            help="Key for signing. Default: as in the scenario.",
        ),
    ] = None,
    allow_arming: AllowArmingOption = False,
    settings: SetOption = None,
) -> None:
    """Bridge one flight controller to its UAV process; without --allow-arming it never arms.

    Ctrl-C lands a flying vehicle. A second Ctrl-C ends the bridge at once, and the failsafe of the
    vehicle acts.
    """
    with ros.required("install the extras [ros,mavlink] or source ROS 2"):
        from ptnsbc_nodes.bridge.process import bridge as run
    given = options.overrides(settings=settings)
    if connect is not None:
        given[f"mavlink.vehicles.{uav}.connect"] = connect
    chosen = options.scenario_with(scenario, given).bridged()
    sys.exit(run(chosen, uav, signing_key, sys.argv[:1], allow_arming=allow_arming))
