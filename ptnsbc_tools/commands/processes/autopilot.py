"""`ptnsbc autopilot`: stand-in flight controllers, until Ctrl-C."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ptnsbc_tools import console

if TYPE_CHECKING:
    from ptnsbc_autopilot.faults import TimedFault
    from ptnsbc_autopilot.launch import Options
    from ptnsbc_autopilot.server import VehicleServer

Kind = Literal["px4", "ardupilot", "generic"]
_FIRMWARE = {"ardupilot": "arducopter", "generic": "stm32"}  # that a stand-in imitates

_FARTHEST_M = 1e4  # the flat map of a stand-in holds for some kilometres


def autopilot(
    kind: Annotated[
        Kind | None,
        typer.Option(
            "--type",
            help="Autopilot to imitate, as mavlink.autopilot names it. Default: px4, or as in the scenario.",
        ),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(
            "--count",
            min=1,
            max=99,
            help="Number of vehicles. Default: as in the scenario, else 1.",
        ),
    ] = None,
    scenario: Annotated[
        str | None,
        typer.Option(
            "--scenario",
            metavar="SCENARIO",
            help="Scenario with starts (on the ground), plant, wind, and ports, ids and keys.",
        ),
    ] = None,
    port_base: Annotated[
        int | None,
        typer.Option(
            "--port-base",
            min=1,
            max=61000,
            help="Vehicle i, counted from 0, sends to this port + i and listens 40 above. Default: 14540, "
            "or as in the scenario.",
        ),
    ] = None,
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect",
            metavar="udpin:HOST:PORT | udpout:HOST:PORT",
            help="One link and not a pair of ports; vehicle i, counted from 0, takes PORT + i.",
        ),
    ] = None,
    gcs: Annotated[
        str,
        typer.Option("--gcs", metavar="HOST:PORT", help='Link of the ground station; "" for none.'),
    ] = "127.0.0.1:14550",
    gnss: Annotated[
        Literal["plain", "quiet", "rtk", "perfect"],
        typer.Option(
            "--gnss",
            help="GNSS receiver; plain drifts like that of a simulated PX4, quiet has a twentieth of its noise.",
        ),
    ] = "plain",
    origin_spread: Annotated[
        float,
        typer.Option(
            "--origin-spread",
            metavar="M",
            min=0.0,
            max=_FARTHEST_M,
            help="Distance of the local origins from each other.",
        ),
    ] = 0.0,
    yaw: Annotated[
        float | None,
        typer.Option(
            "--yaw", metavar="DEG", min=-360.0, max=360.0, help="ENU yaw at boot. Default: random."
        ),
    ] = None,
    battery: Annotated[
        float,
        typer.Option(
            "--battery", metavar="SHARE", min=0.0, max=1.0, help="Charge at the start, 0 to 1."
        ),
    ] = 1.0,
    boot_time: Annotated[
        float,
        typer.Option(
            "--boot-time",
            metavar="X",
            min=0.0,
            help="Factor for the time until the position is valid.",
        ),
    ] = 1.0,
    key: Annotated[
        str | None,
        typer.Option(
            "--signing-key",
            metavar="FILE",
            help="Key for signing; unsigned packets are dropped. {n} is the system id.",
        ),
    ] = None,
    parameters: Annotated[
        list[str] | None,
        typer.Option("--param", metavar="NAME=VALUE", help="Value of a parameter. Repeatable."),
    ] = None,
    control: Annotated[
        int | None,
        typer.Option("--control", metavar="PORT", min=1, max=65535, help="Port for faults."),
    ] = None,
    faults: Annotated[
        list[str] | None,
        typer.Option(
            "--fault",
            metavar="'SECONDS SYSTEM FAULT VALUE'",
            help='A fault, like "20 1 gps off"; docs/autopilot.md lists them. Repeatable.',
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", min=0, help="Seed of errors, yaws and origins.")
    ] = 1,
) -> None:
    """Stand-in flight controllers: real MAVLink on real UDP around simulated quadrotors.

    For tests and demonstrations without hardware. Runs until Ctrl-C.
    """
    from ptnsbc_autopilot.faults import parse_timed_fault
    from ptnsbc_autopilot.launch import Fleet, Network, Options, parse_address, parse_parameter

    fleet = Fleet(count, scenario, gnss, origin_spread, yaw, seed, battery)
    address = parse_address(gcs, "gcs") if gcs else None
    timed = [parse_timed_fault(text) for text in faults or ()]
    network = Network(port_base, connect, address, key)
    changed = dict(parse_parameter(text) for text in parameters or ())
    run(
        Options(_FIRMWARE.get(kind or "", kind), fleet, network, boot_time, changed), control, timed
    )


def run(options: Options, control_port: int | None, timed: list[TimedFault]) -> None:
    """Build the vehicles, open the ports and serve them."""
    from ptnsbc_autopilot.faults import FaultPort
    from ptnsbc_autopilot.launch import stations
    from ptnsbc_autopilot.server import serve
    from ptnsbc_nodes.runtime import environment
    from ptnsbc_nodes.runtime.signals import StopRequest

    began = time.monotonic()

    def say(line: str) -> None:
        console.say(f"{time.monotonic() - began:9.2f} {line}")

    with StopRequest() as stop:
        say("autopilot: starting; the first start compiles for some seconds")
        start_t = time.monotonic()
        fleet = stations(options, start_t, say)
        vehicles = [station.vehicle for station in fleet]
        with FaultPort(vehicles, start_t, port=control_port, timed=timed, log=say) as control:
            # A real flight controller has a processor of its own; these share one.
            environment.prefer_punctuality()
            serve(fleet, lambda: stop.came, control.poll, lambda: _ready(fleet, say))
        for station in fleet:
            dropped = sum(end.codec.dropped for end in station.endpoints)
            if dropped:
                say(f"autopilot: system {station.vehicle.system}: {dropped} packets dropped")
        say("autopilot: stopped")


def _ready(fleet: list[VehicleServer], say: Callable[[str], None]) -> None:
    for station in fleet:
        ends = ", ".join(
            f"{end.listen.port or 'any'} -> {end.partner.port if end.partner else 'who calls'}"
            for end in station.endpoints
        )
        place = " ".join(f"{v:.2f}" for v in station.vehicle.flight.truth_enu)
        say(f"autopilot: system {station.vehicle.system} at {place} m, udp {ends}")
