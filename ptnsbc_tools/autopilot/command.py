"""Run stand-in flight controllers until interrupted."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from ptnsbc_nodes.autopilot.launch import Options

Kind = Literal["px4", "arducopter", "stm32"]


def autopilot(
    kind: Annotated[Kind, typer.Option("--type", help="Whose rules it follows.")] = "px4",
    count: Annotated[
        int | None,
        typer.Option(
            "--count", min=1, max=99, help="Vehicles; as many as the scenario has, else 1."
        ),
    ] = None,
    scenario: Annotated[
        str | None,
        typer.Option("--scenario", metavar="SCENARIO", help="Starts (on the ground), plant, wind."),
    ] = None,
    port_base: Annotated[
        int,
        typer.Option(
            "--port-base",
            min=1,
            max=61000,
            help="Vehicle i from 0 sends to this port + i and listens 40 above.",
        ),
    ] = 14540,
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect",
            metavar="udpin:HOST:PORT | udpout:HOST:PORT",
            help="Instead of the pair of ports; vehicle i from 0 takes PORT + i.",
        ),
    ] = None,
    gcs: Annotated[
        str, typer.Option("--gcs", metavar="HOST:PORT", help='Ground station\'s link; "" for none.')
    ] = "127.0.0.1:14550",
    gnss: Annotated[
        Literal["plain", "rtk", "perfect"],
        typer.Option("--gnss", help="Receiver; plain drifts as a simulated PX4 does."),
    ] = "plain",
    origin_spread: Annotated[
        float,
        typer.Option("--origin-spread", metavar="M", min=0.0, help="Local origins so far away."),
    ] = 0.0,
    yaw: Annotated[
        float | None,
        typer.Option("--yaw", metavar="DEG", help="ENU yaw at boot; any when not given."),
    ] = None,
    battery: Annotated[
        float, typer.Option("--battery", min=0.0, max=1.0, help="Charge at the start.")
    ] = 1.0,
    boot_time: Annotated[
        float,
        typer.Option("--boot-time", min=0.0, help="Scales the time until the position is valid."),
    ] = 1.0,
    key: Annotated[
        str | None,
        typer.Option("--key", metavar="FILE", help="Sign, and drop unsigned; {n}: system id."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of errors, yaws and origins.")] = 1,
) -> None:
    """Stand-in flight controllers: real MAVLink on real UDP around simulated quadrotors.

    For tests and demonstrations without hardware. Runs until Ctrl-C.
    """
    from ptnsbc_nodes.autopilot.launch import Network, Options, parse_address
    from ptnsbc_nodes.autopilot.starts import Fleet

    fleet = Fleet(count, scenario, gnss, origin_spread, yaw, seed, battery)
    address = parse_address(gcs, "gcs") if gcs else None
    network = Network("127.0.0.1", port_base, connect, address, key)
    run(Options(kind, fleet, network, boot_time))


def run(options: Options) -> None:
    """Build the vehicles, open the ports, and serve."""
    from ptnsbc_nodes.autopilot.launch import stations
    from ptnsbc_nodes.autopilot.server import serve
    from ptnsbc_nodes.stop import StopRequest

    began = time.monotonic()

    def say(line: str) -> None:
        print(f"autopilot {time.monotonic() - began:8.2f} {line}", file=sys.stderr, flush=True)

    with StopRequest() as stop:
        say(f"starting {options.kind}; the first start compiles for some seconds")
        fleet = stations(options, time.monotonic(), say)
        for station in fleet:
            ends = ", ".join(
                f"{end.listen.port} -> {end.partner.port if end.partner else 'who calls'}"
                for end in station.endpoints
            )
            say(f"uav {station.vehicle.system}: udp {ends}")
        serve(fleet, lambda: stop.came)
        say("stopped")
