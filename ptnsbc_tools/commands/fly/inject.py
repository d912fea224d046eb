"""`ptnsbc inject`: a fault into a fleet that flies."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console, ros
from ptnsbc_tools.options import FlyingDomainOption, NamespaceOption, full_namespace

if TYPE_CHECKING:
    from ptnsbc_sim.scenario.mission.faults import FaultBlock

KINDS = (
    "silence", "loss", "delay", "nan", "jump", "kill", "freeze", "restart", "clock_offset", "disk_full",
    "battery", "gps_off",
)  # fmt: skip
"""The names in FAULTS, here too: --help does without the package of scenarios."""

_PATIENCE_S = 15.0
_OPTIONS = {
    "uav": "--uav", "process": "--process", "duration_s": "--duration", "share": "--share",
    "delay_s": "--delay", "offset_m": "--offset", "offset_s": "--clock", "charge": "--charge",
}  # fmt: skip
"""The option of each key of a fault."""


class InjectError(PtnsbcError):
    """A fault that cannot be injected."""


def inject(
    kind: Annotated[str, typer.Argument(metavar="FAULT", help=f"One of {', '.join(KINDS)}.")],
    uav: Annotated[
        int | None, typer.Option("--uav", metavar="N", help="UAV that it strikes.")
    ] = None,
    process: Annotated[
        str | None,
        typer.Option("--process", metavar="NAME", help="Process: uavN, bridgeN, sim, recorder."),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            "--duration", metavar="S", help="How long. Default: to the end of the flight."
        ),
    ] = None,
    share: Annotated[
        float | None,
        typer.Option("--share", metavar="SHARE", help="loss: fraction of the messages."),
    ] = None,
    delay: Annotated[
        float | None, typer.Option("--delay", metavar="S", help="delay: how late.")
    ] = None,
    offset: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            "--offset", metavar="X Y Z", help="jump: offset of the position in metres, ENU."
        ),
    ] = None,
    clock: Annotated[
        float | None,
        typer.Option("--clock", metavar="S", help="clock_offset: added to the stamps."),
    ] = None,
    charge: Annotated[
        float | None,
        typer.Option("--charge", metavar="SHARE", help="battery: charge of a stand-in, 0 to 1."),
    ] = None,
    control: Annotated[
        int | None,
        typer.Option(
            "--control",
            metavar="PORT",
            min=1,
            max=65535,
            help="battery, gps_off: port of `ptnsbc autopilot --control`.",
        ),
    ] = None,
    domain: FlyingDomainOption = None,
    namespace: NamespaceOption = "",
) -> None:
    """Inject a fault into a running fleet, to see what it does.

    The fleet must fly a scenario with the key `faults`; an empty list will do. The fault begins when
    the fleet hears of it. docs/faults.md lists the kinds.
    """
    from ptnsbc_sim.scenario.mission.faults import AUTOPILOT

    fault = _fault(
        kind=kind,
        uav=uav,
        process=process,
        duration_s=duration,
        share=share,
        delay_s=delay,
        offset_m=None if offset is None else list(offset),
        offset_s=clock,
        charge=charge,
    )
    if fault.rule.strikes == AUTOPILOT:
        _strike_stand_in(fault, control)
        return
    if not fault.rule.live:
        raise InjectError(f"{kind}: expected it under faults in the scenario")
    with ros.required(ros.INSTALL):
        from ptnsbc_nodes.comm.seal import operators_seal
        from ptnsbc_nodes.fleet.coordinator_node import Coordinator
        from ptnsbc_nodes.runtime import environment
    number = environment.named_domain() if domain is None else domain
    name = f"inject_{os.getpid()}"
    with Coordinator(number, name, full_namespace(namespace), seal=operators_seal()) as node:
        listeners = node.inject(fault, _PATIENCE_S)
    if not listeners:
        raise InjectError(
            f"domain {number}: nobody takes faults: expected a fleet there whose scenario has the key "
            "faults; an empty list will do"
        )
    console.say(f"injected: {_shown(fault)}; {listeners} processes listened")


def _fault(**keys: Any) -> FaultBlock:
    """The fault of the options; InjectError when they do not go together."""
    from pydantic import ValidationError

    from ptnsbc_sim.scenario.mission.faults import FaultBlock, fault_problems

    given = {key: value for key, value in keys.items() if value is not None}
    if keys["kind"] not in KINDS:
        raise InjectError(f"fault {keys['kind']}: expected one of {', '.join(KINDS)}")
    try:
        fault = FaultBlock.model_validate({**given, "at_s": 0.0})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise InjectError(_in_options(f"{where}: {first.get('input')}: {first['msg']}")) from None
    uavs = [number for number in (fault.uav, fault.struck_uav) if number is not None]
    bridges = [int(fault.victim.removeprefix("bridge"))] if "bridge" in fault.victim else []
    for problem in fault_problems(fault, [*uavs, *bridges]):
        raise InjectError(_in_options(problem))
    return fault


def _in_options(problem: str) -> str:
    """A problem with the options in place of the keys of a scenario."""
    return re.sub(rf"\b({'|'.join(_OPTIONS)})\b", lambda key: _OPTIONS[key[0]], problem)


def _shown(fault: FaultBlock) -> str:
    return fault.text.replace(" at 0 s", "")


def _strike_stand_in(fault: FaultBlock, control: int | None) -> None:
    """Tell a stand-in, whose system id is the number of its UAV unless the scenario says otherwise."""
    from ptnsbc_autopilot.faults import send_fault

    if control is None:
        raise InjectError(
            f"{fault.kind}: expected --control PORT, as of `ptnsbc autopilot --control PORT`"
        )
    if fault.duration_s is not None:
        raise InjectError(f"--duration {fault.duration_s:g}: a stand-in takes none: remove it")
    what = f"battery {fault.charge}" if fault.kind == "battery" else "gps off"
    send_fault(control, f"{fault.uav} {what}")
    console.say(f"injected: {_shown(fault)}")
