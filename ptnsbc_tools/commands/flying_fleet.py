"""Commands to a fleet that flies: `ptnsbc mission`, `ptnsbc view` and `ptnsbc stop`."""

from __future__ import annotations

import json as json_text
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.emergency import KILL, LAND, Order, forget_dead, release, runtime_folder
from ptnsbc_tools import console, ros
from ptnsbc_tools.limits import LONGEST_S
from ptnsbc_tools.options import (
    FlyingDomainOption,
    JsonOption,
    NamespaceOption,
    PlainOption,
    argument,
    group,
    option,
    scenario_with,
)

if TYPE_CHECKING:
    from ptnsbc_nodes.fleet.emergency_stop import EmergencyStop
    from ptnsbc_nodes.fleet.fleet_node import LauncherNode

_ANSWER_S = 5.0
_HEALTH_S = 10.0  # for discovery, and two statuses
_SERVICE_S = 3.0
_LEADER_S = 6.0  # to be found on a busy machine: nothing waits for it
_DISCOVERY_S = 3.0
_MISSING = 1
_LOOK_S = 0.02
_FIRST = "1"
_FLEETS = {"start": "", "arm": " that waits for its operator (ptnsbc fleet --wait)"}
_FLYING = " that flies a scenario with the key mission"

mission = group("The legs of a flying fleet: list, start, cancel; arm before them.")


@mission.command("list")
def list_legs(
    domain: FlyingDomainOption = None, namespace: NamespaceOption = "", json: JsonOption = False
) -> None:
    """Print the legs of the mission that a fleet flies, with their times since the first epoch."""
    legs = json_text.loads(_answer("mission", domain, namespace))
    if json:
        console.print_json(legs)
        return
    from ptnsbc_tools.tables import mission_list

    console.out().print(mission_list(legs))


@mission.command()
def start(
    leg: Annotated[str, argument("LEG", "Name or number of the leg, as `list` prints it.")],
    domain: FlyingDomainOption = None,
    namespace: NamespaceOption = "",
) -> None:
    """Begin a leg half a second from now, wherever the mission is; a leg that cannot be flown from there is refused.

    A flight that waits for its operator (`ptnsbc fleet --wait`) is started by leg 1, and by another leg too: the
    formation comes about first, and the legs between are left out.
    """
    if leg == _FIRST:
        console.say(_answer("start", domain, namespace))
        return
    legs = json_text.loads(_answer("mission", domain, namespace))["legs"]
    known = {one["name"]: one["number"] for one in legs if one["number"] > 1}
    numbers = {str(number): number for number in known.values()}
    number = known.get(leg, numbers.get(leg))
    if number is None:
        raise PtnsbcError(f"leg {leg}: expected one of {', '.join(known)}")
    console.say(_answer(f"leg_{number}", domain, namespace))


@mission.command()
def cancel(domain: FlyingDomainOption = None, namespace: NamespaceOption = "") -> None:
    """Let the leader come to rest, and the formation with it; no later leg begins by itself."""
    console.say(_answer("cancel", domain, namespace))


@mission.command()
def arm(domain: FlyingDomainOption = None, namespace: NamespaceOption = "") -> None:
    """Let the vehicles of a fleet that waits for its operator arm and take off (`ptnsbc fleet --wait`)."""
    console.say(_answer("arm", domain, namespace))


def _answer(service: str, domain: int | None, namespace: str) -> str:
    """The answer of the leader; PtnsbcError when no fleet with a mission is there, or it refuses."""
    number = _flying_domain(domain)
    with ros.required():
        from ptnsbc_nodes.comm.seal import operators_seal
        from ptnsbc_nodes.fleet.fleet_node import FleetNode, LeaderClient
    name = f"mission_{os.getpid()}"
    with (
        FleetNode(number, name, namespace, seal=operators_seal()) as node,
        console.patience("looking for the fleet"),
    ):
        answer = LeaderClient(node).ask(service, _ANSWER_S)
    if answer.accepted:
        return answer.message
    reason = answer.message
    if not answer.found:
        reason = (
            f"no fleet answered: expected one there{_FLEETS.get(service, _FLYING)}; "
            "choose another by --domain N or --namespace NAME"
        )
    raise PtnsbcError(f"domain {number}: {reason}")


def view(
    scenario: Annotated[
        str | None, argument("[SCENARIO]", "What is flown. Default: as a UAV of the fleet says.")
    ] = None,
    domain: FlyingDomainOption = None,
    namespace: NamespaceOption = "",
    port: Annotated[int, option("--port", "Of the page. Default: a free one.", 0, 65535)] = 0,
    plain: PlainOption = False,
    healthy: Annotated[
        str,
        option(
            "--healthy PROCESSES",
            "Show nothing: exit with 1 when one of these processes (uav3,sim) is silent or reports an error.",
        ),
    ] = "",
    launched: Annotated[bool, option("--launched", "", hidden=True)] = False,
    page: Annotated[bool, option("--page/--no-page", "", hidden=True)] = True,
) -> None:
    """Show a flying fleet live, on a page and in the terminal.

    The page, whose address is printed, is on this host alone and wants the token of its address. Ctrl-C ends
    the view; the fleet flies on.
    """
    number = _flying_domain(domain)
    if healthy:
        raise typer.Exit(_health(number, namespace, healthy.split(",")))
    with ros.required():
        from ptnsbc_tools.live.watch import watch, words_on_stdin, write_frame
    from ptnsbc_tools.live.dashboard import Dashboard

    flown = None if scenario is None else scenario_with(scenario, {})
    look = partial(watch, number, namespace, flown, port=port if page else None)
    if launched:
        look(console.say, lambda _: write_frame, next_word=words_on_stdin())
    elif plain or not sys.stdout.isatty():
        look(console.say)
    else:
        with Dashboard() as dashboard:
            look(dashboard.say, dashboard.sink)


def _health(domain: int, namespace: str, names: list[str]) -> int:
    """Say what is wrong with these processes; the exit code."""
    with ros.required():
        from ptnsbc_nodes.view.observer import Observer
    with Observer(domain, namespace, f"view_{os.getpid()}") as observer:
        wrong = observer.ailments(names, _HEALTH_S)
    for name, what in wrong.items():
        console.say(f"{name}: {what}")
    return 1 if wrong else 0


def _flying_domain(domain: int | None) -> int:
    """The domain of --domain or ROS_DOMAIN_ID, else of the only fleet of this host, else 0; PtnsbcError for several."""
    from ptnsbc_nodes.runtime.environment import flying_domains, named_domain

    if domain is not None:
        return domain
    flying = [] if os.environ.get("ROS_DOMAIN_ID") else flying_domains()
    if len(flying) > 1:
        domains = ", ".join(map(str, flying))
        raise PtnsbcError(f"fleets of this host fly in the domains {domains}: expected --domain N")
    if not flying:
        return named_domain()
    console.say(f"domain {flying[0]}: the only fleet of this host")
    return flying[0]


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
    home: Annotated[
        list[int] | None,
        option("--return N", "Send UAV N home by its autopilot's own mode, and no other one."),
    ] = None,
    patience: Annotated[
        float, option("--patience S", "Repeat the order for at most this time.", 0.5, LONGEST_S)
    ] = 10.0,
    domain: FlyingDomainOption = None,
    namespace: NamespaceOption = "",
) -> None:
    """Land every vehicle of a flying fleet, or stop its motors.

    Repeats until every bridge has answered. The order holds: a bridge that starts again obeys it too, until a
    new `ptnsbc fleet` or --clear releases it. Prints what every vehicle does. --return is for one vehicle, and
    is not held.
    """
    if home and (len(home) > 1 or kill or pilots_too or ready or clear):
        raise typer.BadParameter(
            "--return: expected one UAV and no other order: ways home cross, and without it each lands where it is"
        )
    number = _flying_domain(domain)
    folder = runtime_folder(number, namespace)
    if home:
        from ptnsbc_nodes.fleet.emergency_stop import order_return

        console.say(order_return(folder, home[0], patience))
        return
    if clear:
        held = release(folder)
        forget_dead(folder)
        console.say(f"released: {held.text}" if held.what else f"no order holds in domain {number}")
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
    if (
        ready and operation.local
    ):  # nobody of the flight need get to know a terminal that only waits
        _wait_for_key(operation, kill=kill)
        ready = False
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

    try:
        with ros.required(f"{ros.INSTALL}: without it an order reaches bridges of this host only"):
            from ptnsbc_nodes.fleet.fleet_node import LauncherNode
    except PtnsbcError as error:  # the bridges of this host need no middleware
        if not (ready or operation.bridges):
            raise _nobody(domain, str(error)) from None
        console.say(f"only bridges of this host are reached: {error}")
        return code if local else _give_here(operation, patience, ready=ready, kill=kill)
    with LauncherNode(domain, f"stop_{os.getpid()}", fleet, seal=operators_seal()) as node:
        if not local:
            operation.remote = node
            if ready:
                _wait_for_key(operation, kill=kill)
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


def _give_here(operation: EmergencyStop, patience: float, *, ready: bool, kill: bool) -> int:
    if ready:
        _wait_for_key(operation, kill=kill)
        operation.begin()
    operation.run(patience)
    return _report(operation)


def _tell_leader(node: LauncherNode, domain: int, *, kill: bool) -> int:
    refusal = node.leader.call("stop", _SERVICE_S)
    if refusal is not None:
        raise _nobody(domain, f"{refusal}: expected a fleet there")
    motors = "; a simulated fleet has no motors to stop" if kill else ""
    console.say(f"landing: the leader is told, there is no bridge{motors}")
    return 0


def _nobody(domain: int, why: str) -> PtnsbcError:
    return PtnsbcError(
        f"domain {domain}: no bridge listens, and {why}. The order holds: a bridge that starts "
        "there obeys it, until `ptnsbc stop --clear`"
    )


def _report(operation: EmergencyStop) -> int:
    outcomes = operation.outcomes()
    for outcome in outcomes:
        console.say(f"{outcome.name}: {outcome.text}")
    missing = [outcome.name for outcome in outcomes if not outcome.obeyed]
    if missing:
        console.say(f"error: not obeyed: {', '.join(missing)}: keep away from it")
        return _MISSING
    return 0


def _wait_for_key(operation: EmergencyStop, *, kill: bool) -> None:
    """Look for bridges until a key is pressed; Ctrl-C leaves without an order."""
    what = "STOP ALL MOTORS" if kill else "LAND ALL"
    known: dict[str, str] | None = None
    with _single_keys() as descriptor:
        remote = operation.remote
        while not select.select([descriptor], [], [], _LOOK_S if remote is None else 0.0)[0]:
            if remote is not None:
                remote.spin(_LOOK_S)
            ways = operation.rehearse()
            if ways not in (known, None):
                known = ways or {}
                found = ", ".join(f"{name} {way}" for name, way in known.items()) or "no bridge yet"
                console.say(f"ready: any key: {what}: {found} (Ctrl-C: no order)")
        if not os.read(descriptor, 1):
            raise PtnsbcError("--ready: the input has ended: expected a terminal to press a key in")


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
