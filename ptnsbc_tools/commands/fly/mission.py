"""`ptnsbc mission`: the legs of a flying fleet: list them, begin one, cancel the present one."""

from __future__ import annotations

import json as json_text
import os
from typing import Annotated, Any

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console, options, ros

_PATIENCE_S = 5.0
_FIRST = "1"
_FLEETS = {"start": "", "arm": " that waits for its operator (ptnsbc fleet --wait)"}
_FLYING = " that flies a scenario with the key mission"

app = typer.Typer(
    no_args_is_help=True, help="The legs of a flying fleet: list, start, cancel; arm before them."
)


class MissionError(PtnsbcError):
    """A word that the leader did not take."""


LegArgument = Annotated[
    str, typer.Argument(metavar="LEG", help="Name or number of the leg, as `list` prints it.")
]


@app.command("list")
def list_(
    domain: options.FlyingDomainOption = None,
    namespace: options.NamespaceOption = "",
    json: options.JsonOption = False,
) -> None:
    """Print the legs of the mission that a fleet flies, with their times since the first epoch."""
    found = _ask("mission", domain, namespace)
    if json:
        console.print_json(found)
        return
    from ptnsbc_tools.tables import mission_list

    console.out().print(mission_list(found))


@app.command()
def start(
    leg: LegArgument,
    domain: options.FlyingDomainOption = None,
    namespace: options.NamespaceOption = "",
) -> None:
    """Begin a leg half a second from now, wherever the mission is; a leg that cannot be flown from there is refused.

    Leg 1 starts a flight that waits for its operator (`ptnsbc fleet --wait`).
    """
    if leg == _FIRST:
        console.say(_answer("start", domain, namespace))
        return
    legs = _ask("mission", domain, namespace)["legs"]
    known = {one["name"]: one["number"] for one in legs if one["number"] > 1}
    numbers = {str(number): number for number in known.values()}
    number = known.get(leg, numbers.get(leg))
    if number is None:
        raise MissionError(f"leg {leg}: expected one of {', '.join(known)}")
    console.say(_answer(f"leg_{number}", domain, namespace))


@app.command()
def cancel(
    domain: options.FlyingDomainOption = None, namespace: options.NamespaceOption = ""
) -> None:
    """Let the leader come to rest, and the formation with it; no later leg begins by itself."""
    console.say(_answer("cancel", domain, namespace))


@app.command()
def arm(domain: options.FlyingDomainOption = None, namespace: options.NamespaceOption = "") -> None:
    """Let the vehicles of a fleet that waits for its operator arm and take off (`ptnsbc fleet --wait`)."""
    console.say(_answer("arm", domain, namespace))


def _ask(service: str, domain: int | None, namespace: str) -> Any:
    return json_text.loads(_answer(service, domain, namespace))


def _answer(service: str, domain: int | None, namespace: str) -> str:
    """The answer of the leader.

    Raises:
        MissionError: no fleet with a mission is there, or it refuses.
    """
    fleet = options.full_namespace(namespace)
    with ros.required("install the extra [ros] or source ROS 2"):
        from ptnsbc_nodes.comm.seal import operators_seal
        from ptnsbc_nodes.fleet.coordinator_node import Coordinator, not_there
        from ptnsbc_nodes.runtime import environment
    number = environment.named_domain() if domain is None else domain
    with Coordinator(number, f"mission_{os.getpid()}", fleet, seal=operators_seal()) as coordinator:
        done, said = coordinator.ask(service, _PATIENCE_S)
    if not done and said == not_there(service):
        raise MissionError(
            f"domain {number}: no fleet answered: expected one there{_FLEETS.get(service, _FLYING)}; "
            "choose another by --domain N or --namespace NAME"
        )
    if not done:
        raise MissionError(f"domain {number}: {said}")
    return said
