"""Commands for single vehicles: `ptnsbc bridge`, and `ptnsbc autopilot`, which stands in for them."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from ptnsbc_tools import console, ros
from ptnsbc_tools.options import AllowArmingOption, SetOption, argument, option, scenario_with

_EXAMPLE = "experiment_4"
_INSTALL = "install the extras [ros,mavlink] or source ROS 2"
_FARTHEST_M = 1e4  # the flat map of a stand-in holds for some kilometres


def bridge(
    uav: Annotated[int, option("--uav N", "Id of the UAV in the scenario.")],
    scenario: Annotated[
        str, argument("[SCENARIO]", "Scenario of the fleet, with limits, fence and links.")
    ] = _EXAMPLE,
    connect: Annotated[
        str | None,
        option(
            "--connect LINK",
            "udpin:, udpout: or tcp:HOST:PORT, or serial:DEVICE[:BAUD]. Default: as in the scenario.",
        ),
    ] = None,
    signing_key: Annotated[
        Path | None, option("--signing-key FILE", "Key for signing. Default: as in the scenario.")
    ] = None,
    allow_arming: AllowArmingOption = False,
    settings: SetOption = None,
) -> None:
    """Bridge one flight controller to its UAV process; without --allow-arming it never arms.

    Ctrl-C lands a flying vehicle. A second Ctrl-C ends the bridge at once, and the failsafe of the
    vehicle acts.
    """
    with ros.required(_INSTALL):
        from ptnsbc_nodes.bridge.process import serve_bridge
    from ptnsbc_sim.scenario.reading.reader import set_keys

    keys = set_keys(settings or ())
    if connect is not None:
        keys[f"mavlink.vehicles.{uav}.connect"] = connect
    flown = scenario_with(scenario, keys).bridged()
    sys.exit(
        serve_bridge(flown, uav, sys.argv[:1], signing_key=signing_key, allow_arming=allow_arming)
    )


@dataclass(frozen=True)
class StandIns:
    """The vehicles that stand-in flight controllers have, and their links."""

    kind: Annotated[
        Literal["px4", "ardupilot", "generic"] | None,
        option(
            "--type",
            "Autopilot to imitate, as mavlink.autopilot names it. Default: px4, or as in the scenario.",
        ),
    ] = None
    count: Annotated[
        int | None,
        option("--count", "Number of vehicles. Default: as in the scenario, else 1.", 1, 99),
    ] = None
    scenario: Annotated[
        str | None,
        option(
            "--scenario SCENARIO",
            "Scenario with starts (on the ground), plant, wind, and ports, ids and keys.",
        ),
    ] = None
    gnss: Annotated[
        Literal["plain", "quiet", "rtk", "perfect"],
        option(
            "--gnss",
            "GNSS receiver; plain drifts like that of a simulated PX4, quiet has a twentieth of its noise.",
        ),
    ] = "plain"
    origin_spread: Annotated[
        float,
        option(
            "--origin-spread M", "Distance of the local origins from each other.", 0.0, _FARTHEST_M
        ),
    ] = 0.0
    yaw: Annotated[
        float | None, option("--yaw DEG", "ENU yaw at boot. Default: random.", -360.0, 360.0)
    ] = None
    battery: Annotated[
        float, option("--battery SHARE", "Charge at the start, 0 to 1.", 0.0, 1.0)
    ] = 1.0
    boot_time: Annotated[
        float, option("--boot-time X", "Factor for the time until the position is valid.", 0.0)
    ] = 1.0
    parameters: Annotated[
        list[str] | None, option("--param NAME=VALUE", "Value of a parameter. Repeatable.")
    ] = None
    seed: Annotated[int, option("--seed N", "Seed of errors, yaws and origins.", 0)] = 1

    port_base: Annotated[
        int | None,
        option(
            "--port-base",
            "Vehicle i, counted from 0, sends to this port + i and listens 40 above. Default: 14540, "
            "or as in the scenario.",
            1,
            61000,
        ),
    ] = None
    connect: Annotated[
        str | None,
        option(
            "--connect udpin:HOST:PORT | udpout:HOST:PORT",
            "One link and not a pair of ports; vehicle i, counted from 0, takes PORT + i.",
        ),
    ] = None
    gcs: Annotated[str, option("--gcs HOST:PORT", 'Link of the ground station; "" for none.')] = (
        "127.0.0.1:14550"
    )
    key: Annotated[
        str | None,
        option(
            "--signing-key FILE",
            "Key for signing; unsigned packets are dropped. {n} is the system id.",
        ),
    ] = None


def autopilot(
    stand_ins: StandIns,
    control: Annotated[int | None, option("--control PORT", "Port for faults.", 1, 65535)] = None,
    faults: Annotated[
        list[str] | None,
        option(
            "--fault 'SECONDS SYSTEM FAULT VALUE'",
            'A fault, like "20 1 gps off"; docs/autopilot.md lists them. Repeatable.',
        ),
    ] = None,
) -> None:
    """Stand-in flight controllers: real MAVLink on real UDP around simulated quadrotors.

    For tests and demonstrations without hardware. Runs until Ctrl-C.
    """
    from ptnsbc_autopilot import launch
    from ptnsbc_autopilot.fault_lines import parse_timed_fault
    from ptnsbc_nodes.runtime import environment
    from ptnsbc_nodes.runtime.signals import StopRequest

    like, began = stand_ins, time.monotonic()
    fleet = launch.Fleet(
        like.count, like.scenario, like.gnss, like.origin_spread, like.yaw, like.seed, like.battery
    )
    address = launch.parse_address(like.gcs, "gcs") if like.gcs else None
    network = launch.Network(like.port_base, like.connect, address, like.key)
    timed = [parse_timed_fault(text) for text in faults or ()]
    parameters = dict(launch.parse_parameter(text) for text in like.parameters or ())
    firmware = None if like.kind is None else launch.FIRMWARE[like.kind]
    options = launch.Options(firmware, fleet, network, like.boot_time, parameters)

    def say(line: str) -> None:
        console.say(f"{time.monotonic() - began:9.2f} {line}")

    with StopRequest() as stop:
        # A real flight controller has a processor of its own; these share one.
        first = environment.prefer_punctuality
        launch.run(options, control, timed, say, lambda: stop.came, first)
