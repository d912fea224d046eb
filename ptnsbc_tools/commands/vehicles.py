"""Commands for single vehicles: `ptnsbc bridge` and `ptnsbc tune`, and `ptnsbc autopilot`, which stands in for them."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console, ros
from ptnsbc_tools.options import (
    AllowArmingOption,
    DomainOption,
    JsonOption,
    SetOption,
    argument,
    option,
    scenario_with,
)

if TYPE_CHECKING:
    from ptnsbc_nodes.bridge.hover_test import Identified, Settings
    from ptnsbc_sim.scenario import Scenario

_EXAMPLE = "experiment_4"
_INSTALL = "install the extras [ros,mavlink] or source ROS 2"
_FARTHEST_M = 1e4  # the flat map of a stand-in holds for some kilometres


@dataclass(frozen=True)
class Vehicle:
    """One vehicle of a scenario, and the link to it."""

    uav: Annotated[int, option("--uav N", "Id of the UAV in the scenario.")]
    scenario: Annotated[
        str, argument("[SCENARIO]", "Scenario of the fleet, with limits, fence and links.")
    ] = _EXAMPLE
    connect: Annotated[
        str | None,
        option(
            "--connect LINK",
            "udpin:, udpout: or tcp:HOST:PORT, or serial:DEVICE[:BAUD]. Default: as in the scenario.",
        ),
    ] = None
    signing_key: Annotated[
        Path | None, option("--signing-key FILE", "Key for signing. Default: as in the scenario.")
    ] = None
    allow_arming: AllowArmingOption = False
    settings: SetOption = None

    def flown(self) -> Scenario:
        """The scenario as real vehicles fly it."""
        from ptnsbc_sim.scenario.reading.reader import set_keys

        keys = set_keys(self.settings or ())
        if self.connect is not None:
            keys[f"mavlink.vehicles.{self.uav}.connect"] = self.connect
        return scenario_with(self.scenario, keys).bridged()


def bridge(vehicle: Vehicle) -> None:
    """Bridge one flight controller to its UAV process; without --allow-arming it never arms.

    Ctrl-C lands a flying vehicle. A second Ctrl-C ends the bridge at once, and the failsafe of the
    vehicle acts.
    """
    with ros.required(_INSTALL):
        from ptnsbc_nodes.bridge.process import serve_bridge
    code = serve_bridge(
        vehicle.flown(),
        vehicle.uav,
        sys.argv[:1],
        signing_key=vehicle.signing_key,
        allow_arming=vehicle.allow_arming,
    )
    sys.exit(code)


def tune(
    vehicle: Vehicle,
    box: Annotated[
        float, option("--box M", "Side of the box that the vehicle may use.", 0.0, _FARTHEST_M)
    ] = 3.0,
    alike: Annotated[
        bool, option("--alike", "Write the result for all vehicles with the same autopilot.")
    ] = False,
    output: Annotated[
        Path | None, option("--output -o FILE", "Scenario file to write, which extends SCENARIO.")
    ] = None,
    overwrite: Annotated[bool, option("--overwrite", "Replace an existing file.")] = False,
    json: JsonOption = False,
    domain: DomainOption = None,
) -> None:
    """Identify how one vehicle follows velocities in a hover test, and print the settings that fit it.

    The vehicle takes off, flies sinusoids within a box over about a minute, and lands. It lands at once
    outside of its box, at the fence, and at Ctrl-C; a pilot who takes over keeps it.
    """
    with ros.required(_INSTALL):
        from ptnsbc_nodes.bridge.hover_test import fly_hover_test
        from ptnsbc_nodes.bridge.hover_test import settings as fitting
    ros.select_network(None, domain)
    if output is not None and output.exists() and not overwrite:
        raise PtnsbcError(f"{output}: exists: choose another name, or --overwrite")
    uav, flown = vehicle.uav, vehicle.flown()
    found = fly_hover_test(
        flown, uav, vehicle.signing_key, console.say, allow_arming=vehicle.allow_arming, box_m=box
    )
    fits = fitting(flown, found)
    for line in _lines(flown, found, fits):
        console.say(line)
    kind, response = flown.vehicle_link(uav).autopilot, found.response
    uavs = [i for i in flown.uav_ids if alike and flown.vehicle_link(i).autopilot == kind] or [uav]
    keys = {  # the `mavlink` block that makes the scenario fit
        "overrides": {
            **flown.mavlink.overrides,
            "gains.formation.kappa_1_s": round(fits.kappa_1_s, 2),
            "gains.formation.residual": float(f"{fits.residual:.2g}"),
            "gains.formation.deadline_s": fits.deadline_s,
            "gains.filter.bandwidth_1_s": fits.filter_1_s,
        },
        "vehicles": {
            i: {
                "velocity_loop_1_s": round(response.gain, 3),
                "tilt_lag_s": round(response.tilt_lag_s, 3),
            }
            for i in uavs
        },
    }
    if output is not None:
        _write(output, vehicle.scenario, keys, found)
        console.say(f"next: ptnsbc fleet {output} --backend mavlink --allow-arming")
    if json:
        points = [{"hertz": p.hertz, "gain": p.gain, "lag_s": p.lag_s} for p in found.points]
        console.print_json({"points": points, "settings": fits._asdict(), "keys": keys})


def _lines(scenario: Scenario, found: Identified, fits: Settings) -> Iterator[str]:
    for point in found.points:
        model = found.expected(point.hertz)
        yield (
            f"{point.hertz:g} Hz: gain {point.gain:.2f}, lag {point.lag_s:.2f} s "
            f"(model {model.gain:.2f}, {model.lag_s:.2f} s)"
        )
    response, own = found.response, scenario.gains.formation
    yield (
        f"velocity loop {response.gain:.2f} 1/s, lag of the tilt {response.tilt_lag_s:.2f} s, "
        f"drag {found.drag_1_s:.2f} 1/s, link {1e3 * found.delay_s:.0f} ms"
    )
    yield (
        f"gains.formation.kappa_1_s: {fits.kappa_1_s:.2g} instead of {own.kappa_1_s:g}, "
        f"up to {fits.largest_kappa_1_s:.1f} fits"
    )
    yield f"gains.formation.residual: {fits.residual:.2g} instead of {own.residual:g}"
    yield f"gains.filter.bandwidth_1_s: {fits.filter_1_s:g} instead of {scenario.gains.filter.bandwidth_1_s:g}"
    yield (
        f"gains.formation.deadline_s: {fits.deadline_s:g} instead of {own.deadline_s:g}, "
        f"from {fits.shortest_deadline_s:g} s on fits"
    )


def _write(path: Path, base: str, keys: Mapping[str, Any], found: Identified) -> None:
    """A scenario file that extends the one that was given."""
    from ptnsbc_io.files import replacing
    from ptnsbc_sim.scenario.reading.reader import dump, find

    source = find(base)
    if source.resolve() == path.resolve():
        raise PtnsbcError(f"{path}: is the scenario itself: expected another file")
    built_in = os.sep not in base and not Path(base).suffix
    named = base if built_in else os.path.relpath(source, path.parent)
    measured = "".join(
        f"# {point.hertz:g} Hz: gain {point.gain:.2f}, lag {point.lag_s:.2f} s\n"
        for point in found.points
    )
    with replacing(path, folder=True) as part:
        text = f"# By ptnsbc tune: how the vehicle follows a velocity.\n{measured}"
        part.write_text(text + dump({"extends": named, "mavlink": keys}), encoding="utf-8")


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
