"""`ptnsbc security`: who may publish and read what, for the DDS Security of ROS 2."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from ptnsbc_tools import ros
from ptnsbc_tools.options import (
    NamespaceOption,
    ScenarioArgument,
    SetOption,
    group,
    option,
    scenario_with,
    set_keys,
)

security = group("DDS Security: who may publish and read what, where the middleware has it.")


@security.callback()
def _group() -> None:
    pass


@security.command()
def policy(
    scenario: ScenarioArgument,
    backend: Annotated[
        Literal["sim", "mavlink"], option("--backend", "What flies the vehicles.")
    ] = "sim",
    namespace: NamespaceOption = "",
    settings: SetOption = None,
) -> None:
    """Print a policy of sros2: each process may use the edges of the scenario, and no more.

    `ros2 security generate_artifacts -k KEYSTORE -p POLICY` makes a keystore of it, for the ROS domain of its
    environment. `security: required` flies with it.
    """
    with ros.required():
        from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
        from ptnsbc_nodes.security.policy import enclaves
        from ptnsbc_nodes.security.policy import policy as policy_of
    flown = scenario_with(scenario, set_keys(settings))
    edges = CommunicationGraph(flown, FlightOptions(bridged=backend == "mavlink"))
    typer.echo(policy_of(enclaves(flown, edges, backend), namespace), nl=False)
