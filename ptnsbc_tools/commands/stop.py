"""`ptnsbc stop`: land a flying fleet or stop its motors, from any terminal."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.emergency import KILL, LAND, Order, forget_dead, release, runtime_folder
from ptnsbc_tools import console, ros
from ptnsbc_tools.limits import LONGEST_S
from ptnsbc_tools.options import FlyingDomainOption, NamespaceOption, option

if TYPE_CHECKING:
    from ptnsbc_nodes.fleet.emergency_stop import EmergencyStop
    from ptnsbc_nodes.fleet.fleet_node import LauncherNode

_SERVICE_S = 3.0
_LEADER_S = 6.0  # to be found on a busy machine: nothing waits for it
_DISCOVERY_S = 3.0
_MISSING = 1
_LOOK_S = 0.02


class StopError(PtnsbcError):
    """No process of a fleet answered."""


def stop(
    kill: Annotated[
        bool, option("--kill", "Stop all motors at once; vehicles in the air fall.")
    ] = False,
    pilots_too: Annotated[
        bool, option("--all", "Also vehicles that a pilot flies; else they are left alone.")
    ] = False,
    ready: Annotated[
        bool,
        option("--ready", "Find all bridges first, then wait for a key: the order leaves at once."),
    ] = False,
    clear: Annotated[
        bool, option("--clear", "Give no order: release the one that holds on this host.")
    ] = False,
    patience: Annotated[
        float, option("--patience S", "Repeat the order for at most this time.", 0.5, LONGEST_S)
    ] = 10.0,
    domain: FlyingDomainOption = None,
    namespace: NamespaceOption = "",
) -> None:
    """Land every vehicle of a flying fleet, or stop its motors.

    Repeats until every bridge has answered. The order holds: a bridge that starts again obeys it too, until a
    new `ptnsbc fleet` or --clear releases it. Prints what every vehicle does.
    """
    number = ros.domain_number(domain)
    folder = runtime_folder(number, namespace)
    if clear:
        held = release(folder)
        forget_dead(folder)
        console.say(f"released: {held.text}" if held.what else "no order holds")
        return
    from ptnsbc_nodes.fleet.emergency_stop import EmergencyStop
    from ptnsbc_nodes.runtime import environment

    # On a busy host the processes that fly come first, and the order would wait behind them.
    environment.prefer_punctuality()
    operation = EmergencyStop(folder, Order(KILL if kill else LAND, pilots_too))
    try:
        code = _give(operation, number, namespace, patience, ready=ready, kill=kill)
    finally:
        operation.close()
    raise typer.Exit(code)


def _give(
    operation: EmergencyStop, domain: int, fleet: str, patience: float, *, ready: bool, kill: bool
) -> int:
    """Give the order on every path; returns the exit code."""
    local = not ready and bool(operation.bridges) and operation.local
    code = 0
    if not ready:
        operation.begin()
        # Where not all bridges are of this host, those that are need not wait for the middleware.
        done = operation.run(patience if local else 0.1)
    if local:
        code = max(_report(operation), 0 if done else _MISSING)
        if kill:
            return code
    from ptnsbc_nodes.comm.seal import operators_seal

    with ros.required(f"{ros.INSTALL}: without it an order reaches bridges of this host only"):
        from ptnsbc_nodes.fleet.fleet_node import LauncherNode
    with LauncherNode(domain, f"stop_{os.getpid()}", fleet, seal=operators_seal()) as node:
        if not local:
            operation.remote = node
            if ready:
                _wait_for_key(operation, node, kill=kill)
                operation.begin()
            else:
                operation.discover(_DISCOVERY_S)
            if not operation.bridges:
                return _tell_leader(node, domain, kill=kill)
            operation.run(patience)
            code = _report(operation)
        if not kill:  # the vehicles have their order; so the recording has the leg as well
            refusal = node.leader.call("stop", _LEADER_S)
            if refusal is not None:
                console.say(f"the recording lacks the landing: {refusal}")
    return code


def _tell_leader(node: LauncherNode, domain: int, *, kill: bool) -> int:
    refusal = node.leader.call("stop", _SERVICE_S)
    if refusal is not None:
        raise StopError(
            f"domain {domain}: no bridge listens, and {refusal}: expected a fleet there"
        )
    motors = "; a simulated fleet has no motors to stop" if kill else ""
    console.say(f"landing: the leader is told, there is no bridge{motors}")
    return 0


def _report(operation: EmergencyStop) -> int:
    outcomes = operation.outcomes()
    for outcome in outcomes:
        console.say(f"{outcome.name}: {outcome.text}")
    missing = [outcome.name for outcome in outcomes if not outcome.obeyed]
    if missing:
        console.say(f"error: not obeyed: {', '.join(missing)}")
        return _MISSING
    return 0


def _wait_for_key(operation: EmergencyStop, node: LauncherNode, *, kill: bool) -> None:
    """Look for bridges until a key is pressed; Ctrl-C leaves without an order."""
    what = "STOP ALL MOTORS" if kill else "LAND ALL"
    known: list[str] | None = None
    with _single_keys() as descriptor:
        while not select.select([descriptor], [], [], 0.0)[0]:
            node.spin(_LOOK_S)
            operation.look_up()
            if operation.bridges != known:
                known = operation.bridges
                found = ", ".join(known) or "no bridge yet"
                console.say(f"ready: any key: {what}: {found} (Ctrl-C: no order)")
        if not os.read(descriptor, 1):
            raise StopError("--ready: the input has ended: expected a terminal to press a key in")


@contextmanager
def _single_keys() -> Iterator[int]:
    """The descriptor of stdin; a terminal gives each key at once inside the `with`."""
    descriptor = sys.stdin.fileno()
    if not os.isatty(descriptor):
        yield descriptor
        return
    import termios
    import tty

    before = termios.tcgetattr(descriptor)
    try:
        tty.setcbreak(descriptor)
        yield descriptor
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
