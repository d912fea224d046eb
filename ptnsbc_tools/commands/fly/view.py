"""`ptnsbc view`: a page, and a table in the terminal, of a fleet that flies already."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console, ros
from ptnsbc_tools.options import (
    LAST_DOMAIN,
    FoxgloveOption,
    NamespaceOption,
    PlainOption,
    full_namespace,
)

_HEALTH_S = 10.0  # for discovery, and two statuses


class NoFleetError(PtnsbcError):
    """It is not clear which fleet is meant."""


def view(
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="[SCENARIO]", help="What is flown. Default: as a UAV of the fleet says."
        ),
    ] = None,
    domain: Annotated[
        int | None,
        typer.Option(
            "--domain",
            min=0,
            max=LAST_DOMAIN,
            help="ROS domain that the fleet printed. Default: ROS_DOMAIN_ID, or that of the only "
            "fleet of this host.",
        ),
    ] = None,
    namespace: NamespaceOption = "",
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, help="Of the page. Default: a free one.")
    ] = 0,
    foxglove: FoxgloveOption = None,
    plain: PlainOption = False,
    healthy: Annotated[
        str,
        typer.Option(
            "--healthy",
            metavar="PROCESSES",
            help="Show nothing: exit with 1 when one of these processes (uav3,sim) is silent or reports an error.",
        ),
    ] = "",
    frames: Annotated[bool, typer.Option("--frames", hidden=True)] = False,
    page: Annotated[bool, typer.Option("--page/--no-page", hidden=True)] = True,
) -> None:
    """Show a flying fleet live: prints the address of a page, and a table in the terminal.

    The page is on this host alone and wants the token of its address. Ctrl-C ends the view; the
    fleet flies on.
    """
    number = _domain(domain)
    if healthy:
        raise typer.Exit(_health(number, full_namespace(namespace), healthy.split(",")))
    with ros.required():
        from ptnsbc_tools.live.watch import WatchOptions, frames_on_stdout, watch
    from ptnsbc_tools.live.dashboard import Dashboard
    from ptnsbc_tools.options import scenario_with

    flown = None if scenario is None else scenario_with(scenario, {})
    fleet = full_namespace(namespace)
    options = WatchOptions(number, fleet, flown, page=page, port=port, foxglove=foxglove)
    from dataclasses import replace

    if frames:
        watch(replace(options, begin=frames_on_stdout), console.say)
    elif plain or not sys.stdout.isatty():
        watch(options, console.say)
    else:
        with Dashboard() as dashboard:
            watch(replace(options, begin=lambda flown: dashboard.sink(flown)), dashboard.say)


def _health(domain: int, fleet: str, names: Sequence[str]) -> int:
    """Say what is wrong with these processes; the exit code."""
    with ros.required():
        from ptnsbc_nodes.view.observer import Observer
    with Observer(domain, fleet, f"view_{os.getpid()}") as observer:
        wrong = observer.ailments(names, _HEALTH_S)
    for name, what in wrong.items():
        console.say(f"{name}: {what}")
    return 1 if wrong else 0


def _domain(given: int | None) -> int:
    """The domain that is meant.

    Raises:
        NoFleetError: none is named, and this host flies no fleet, or several.
    """
    if given is not None:
        return given
    if os.environ.get("ROS_DOMAIN_ID"):
        from ptnsbc_nodes.runtime import environment

        return environment.named_domain()
    with ros.required():
        from ptnsbc_nodes.view.observer import flying_domains
    found = flying_domains()
    if len(found) == 1:
        return found[0]
    seen = f"fleets fly in the domains {', '.join(map(str, found))}" if found else "no fleet flies"
    raise NoFleetError(f"on this host {seen}: expected --domain N, as `ptnsbc fleet` prints it")
