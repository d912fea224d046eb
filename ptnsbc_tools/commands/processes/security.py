"""`ptnsbc security`: the keystore of DDS Security."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Literal

import typer

from ptnsbc_tools import console, options, ros
from ptnsbc_tools.options import NamespaceOption, ScenarioArgument, SetOption

app = typer.Typer(
    no_args_is_help=True,
    help="DDS Security: who may publish and read what, where the middleware has it.",
)


@app.callback()
def _group() -> None:
    pass


@app.command()
def init(
    scenario: ScenarioArgument,
    folder: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Where to write it. A keystore that is there keeps its authority and its identities.",
        ),
    ],
    backend: Annotated[
        Literal["sim", "mavlink"], typer.Option(help="What flies the vehicles.")
    ] = "sim",
    namespace: NamespaceOption = "",
    domain: Annotated[
        int | None,
        typer.Option("--domain", min=0, max=232, help="The only ROS domain. Default: any."),
    ] = None,
    settings: SetOption = None,
) -> None:
    """Write a keystore for `security: required`: each process may use the edges of the scenario, and no more.

    The layout is that of sros2. A vehicle gets public/ and its own folders of enclaves/, and never private/.
    """
    with ros.required():
        from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
        from ptnsbc_nodes.security.permissions import OPERATOR, permissions
    with ros.required("install the extra [security]"):
        from ptnsbc_nodes.security.keystore import write_keystore
    flown = options.scenario_with(scenario, options.overrides(settings=settings))
    fleet = options.full_namespace(namespace)
    edges = CommunicationGraph(flown, FlightOptions(bridged=backend == "mavlink"))
    granted = list(permissions(flown, edges, backend, fleet))
    write_keystore(folder, granted, domain)
    console.say(f"keystore: {folder}, {len(granted)} identities")
    console.say(
        f"for the fleet:     export ROS_SECURITY_KEYSTORE={shlex.quote(str(folder.resolve()))}"
    )
    console.say(
        "for other commands and ros2, besides: export ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce"
        f" ROS_SECURITY_ENCLAVE_OVERRIDE={fleet}/{OPERATOR}"
    )
