"""From options or a scenario to stand-ins: where they start, what they are, and their ports."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ptnsbc_autopilot.controller import FlightController
from ptnsbc_autopilot.fault_lines import FaultPort, TimedFault
from ptnsbc_autopilot.firmware.arducopter import ArduCopter
from ptnsbc_autopilot.firmware.px4 import Px4
from ptnsbc_autopilot.firmware.stm32 import Stm32
from ptnsbc_autopilot.physics.body import VehicleDescription, default_plant
from ptnsbc_autopilot.physics.frames import PX4_HOME, Geodetic
from ptnsbc_autopilot.physics.navigation import QUALITIES
from ptnsbc_autopilot.server import Address, Codec, Endpoint, VehicleServer, serve
from ptnsbc_autopilot.vehicle import GCS, IMPOSTOR, AutopilotError, Log
from ptnsbc_io.files import read_key
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.scenario import Scenario, load_scenario

KINDS: dict[str, type[FlightController]] = {"px4": Px4, "arducopter": ArduCopter, "stm32": Stm32}

FIRMWARE = {"px4": "px4", "ardupilot": "arducopter", "generic": "stm32"}
"""Types of stand-ins by the autopilot names of scenarios."""

PORT_BASE = 14540
"""PX4's: vehicle i sends to 14540 + i and listens on 14580 + i."""

HOST, ANY = "127.0.0.1", "0.0.0.0"
_LISTEN_OFFSET, _LAST_OWN_PORT = 40, 9
_GCS_OFFSET = 3990  # from 14580 + i to 18570 + i, as PX4's simulation
_LAST_PORT = 65535
_SPACING_M = 2.0  # between starts without a scenario


@dataclass(frozen=True)
class Fleet:
    """The vehicles to start: how many, where, and how accurate."""

    count: int | None = None
    scenario: str | Path | None = None
    gnss: str = "plain"
    origin_spread_m: float = 0.0
    yaw_deg: float | None = None
    seed: int = 1
    battery: float = 1.0


@dataclass(frozen=True)
class Start:
    """One vehicle to start; the last three are from the scenario, None without one."""

    system: int
    body: VehicleDescription
    kind: str | None = None
    connect: str | None = None  # how the bridge reaches it
    key: str | None = None


@dataclass(frozen=True)
class Network:
    """Addresses and keys of the links."""

    port_base: int | None = None  # PORT_BASE, or as the scenario has it
    connect: str | None = None  # instead of the port pairs: udpin:HOST:PORT or udpout:HOST:PORT
    gcs: Address | None = field(default_factory=lambda: Address(HOST, 14550))
    key: str | None = None  # file; {n} stands for the system id


@dataclass(frozen=True)
class Options:
    """All options of the command `ptnsbc autopilot`."""

    kind: str | None = None  # px4, or as the scenario has it
    fleet: Fleet = field(default_factory=Fleet)
    network: Network = field(default_factory=Network)
    boot_time: float = 1.0
    parameters: Mapping[str, float] = field(default_factory=dict)  # instead of the defaults


class LinkAddresses(NamedTuple):
    """The address a stand-in listens on, and its partner until another sender appears."""

    listen: Address
    partner: Address | None


def parse_address(text: str, what: str) -> Address:
    """The address in `HOST:PORT`.

    Raises:
        AutopilotError: the text has another form.
    """
    host, colon, port = text.rpartition(":")
    if not colon or not host or not port.isdigit() or not 0 < int(port) <= _LAST_PORT:
        raise AutopilotError(f"{what} {text!r}: expected HOST:PORT, as 127.0.0.1:14550")
    return Address(host, int(port))


def parse_parameter(text: str) -> tuple[str, float]:
    """The name and the value in `NAME=VALUE`.

    Raises:
        AutopilotError: the text has another form.
    """
    name, equals, value = text.partition("=")
    try:
        return name.strip(), float(value if equals and name.strip() else "")
    except ValueError:
        raise AutopilotError(f'param "{text}": expected NAME=NUMBER') from None


def starts(fleet: Fleet) -> list[Start]:
    """The vehicles to start, all on the ground, with system ids from 1 or those of the scenario.

    Raises:
        AutopilotError: more vehicles than the scenario has, or an unknown receiver.
    """
    if fleet.gnss not in QUALITIES:
        raise AutopilotError(f"gnss={fleet.gnss}: expected one of {', '.join(QUALITIES)}")
    if fleet.scenario is None:
        return [Start(n + 1, _body(fleet, n, None)) for n in range(fleet.count or 1)]
    scenario = load_scenario(fleet.scenario, {"plant.kind": "quadrotor"})
    size = len(scenario.uav_ids)
    count = size if fleet.count is None else fleet.count
    if count > size:
        raise AutopilotError(f"count={count}: expected at most {size}, the UAVs of {scenario.name}")
    return [_start(fleet, n, scenario) for n in range(count)]


def _start(fleet: Fleet, n: int, scenario: Scenario) -> Start:
    link = scenario.vehicle_link(scenario.uav_ids[n])
    body = _body(fleet, n, scenario)
    return Start(link.sysid, body, FIRMWARE[link.autopilot], link.connect, link.signing_key)


def _datum(scenario: Scenario) -> Geodetic:
    origin = scenario.mavlink.world_origin
    if origin is None:
        return PX4_HOME
    return Geodetic(origin.latitude_deg, origin.longitude_deg, origin.altitude_m)


def _body(fleet: Fleet, n: int, scenario: Scenario | None) -> VehicleDescription:
    random = np.random.default_rng((fleet.seed, n))
    yaw = random.uniform(-np.pi, np.pi) if fleet.yaw_deg is None else np.radians(fleet.yaw_deg)
    ground, plant, datum = np.array((_SPACING_M * n, 0.0, 0.0)), default_plant(), PX4_HOME
    if scenario is not None:
        uav_id = scenario.uav_ids[n]
        ground = scenario.uav(uav_id).position * np.array((1.0, 1.0, 0.0))
        plant, datum = plant_config(scenario, uav_id), _datum(scenario)
    return VehicleDescription(
        plant,
        ground,
        float(yaw),
        QUALITIES[fleet.gnss],
        fleet.origin_spread_m,
        datum,
        fleet.battery,
        int(random.integers(1 << 31)),
    )


def stations(options: Options, t: float, say: Log) -> list[VehicleServer]:
    """The stand-ins, booted at t [s], with closed sockets.

    Raises:
        AutopilotError: an option is not valid.
    """
    chosen = starts(options.fleet)
    made = [_station(options, n, start, t, say) for n, start in enumerate(chosen)]
    for name, value in options.parameters.items():
        _set_parameter([station.vehicle for station in made], name, value)
    return made


def run(
    options: Options,
    control_port: int | None,
    timed: Sequence[TimedFault],
    say: Log,
    stop: Callable[[], bool],
    before: Callable[[], object] = lambda: None,
) -> None:
    """Build the vehicles, open the ports and serve them until `stop()`; `before()` is called before they are served.

    Raises:
        AutopilotError: an option is not valid, or a port is taken.
    """
    say("autopilot: starting; the first start compiles for some seconds")
    start_t = time.monotonic()
    fleet = stations(options, start_t, say)

    def ready() -> None:
        for station in fleet:
            ends = ", ".join(
                f"{end.listen.port or 'any'} -> {end.partner.port if end.partner else 'who calls'}"
                for end in station.endpoints
            )
            place = " ".join(f"{v:.2f}" for v in station.vehicle.flight.truth.position_enu)
            say(f"autopilot: system {station.vehicle.system} at {place} m, udp {ends}")

    vehicles = [station.vehicle for station in fleet]
    with FaultPort(vehicles, start_t, port=control_port, timed=timed, log=say) as control:
        before()
        serve(fleet, stop, control.poll, ready)
    for station in fleet:
        dropped = sum(end.codec.dropped for end in station.endpoints)
        if dropped:
            say(f"autopilot: system {station.vehicle.system}: {dropped} packets dropped")
    say("autopilot: stopped")


def _set_parameter(vehicles: Sequence[FlightController], name: str, value: float) -> None:
    """Set a parameter on the vehicles that have it: the vehicles of a mixed fleet have few in common."""
    owners = [vehicle for vehicle in vehicles if name in vehicle.parameters]
    for vehicle in (
        owners or vehicles[:1]
    ):  # without any, the error of the first one lists its names
        vehicle.set_parameter(name, value)


def _station(options: Options, n: int, start: Start, t: float, say: Log) -> VehicleServer:
    network, system = options.network, start.system
    kind = options.kind or start.kind or "px4"
    if kind not in KINDS:
        raise AutopilotError(f"type {kind!r}: expected one of {', '.join(KINDS)}")

    def log(line: str) -> None:
        say(f"{kind} {system}: {line}")

    path = network.key.replace("{n}", str(system)) if network.key else start.key
    key = None if path is None else read_key(Path(path))
    ends = _companion_link(network, n, start)
    endpoints = [Endpoint(ends.listen, ends.partner, Codec(system, key=key))]
    if network.gcs is not None:
        listen = _checked(HOST, (ends.listen.port or PORT_BASE + n) + _GCS_OFFSET)
        endpoints.append(Endpoint(listen, network.gcs, Codec(system, key=key, link_id=GCS)))
    # A second sender with this system id has a port of its own.
    impostor = Endpoint(Address(HOST, 0), None, Codec(system, key=key, link_id=IMPOSTOR))
    # Last, because it compiles: an error above is reported at once.
    vehicle = KINDS[kind](system, start.body, t, boot_time=options.boot_time, say=log)
    return VehicleServer(vehicle, endpoints, impostor)


def _companion_link(network: Network, n: int, start: Start) -> LinkAddresses:
    """The companion's link: by --connect, else as the scenario's bridge expects it, else PX4's pair of ports."""
    if network.connect is not None:
        return _connected(network.connect, n)
    if network.port_base is None and start.connect is not None:
        return _vehicle_end(start.connect)
    base = network.port_base or PORT_BASE
    # PX4's simulations beyond the tenth all send to the tenth's port.
    there = base + (min(n, _LAST_OWN_PORT) if network.port_base is None else n)
    return LinkAddresses(_checked(HOST, base + n + _LISTEN_OFFSET), _checked(HOST, there))


def _connected(connect: str, n: int) -> LinkAddresses:
    kind, _, rest = connect.partition(":")
    if kind not in ("udpin", "udpout"):
        raise AutopilotError(f"connect {connect!r}: expected udpin:HOST:PORT or udpout:HOST:PORT")
    host, port = parse_address(rest, "connect")
    there = _checked(host, port + n)
    return LinkAddresses(there, None) if kind == "udpin" else LinkAddresses(Address(ANY, 0), there)


def _vehicle_end(connect: str) -> LinkAddresses:
    """The vehicle's end of the link to which the bridge connects."""
    kind, _, rest = connect.partition(":")
    if kind not in ("udpin", "udpout"):
        raise AutopilotError(
            f"the scenario's mavlink connect {connect!r}: expected udpin or udpout; "
            "give the stand-in's with --connect"
        )
    host, port = parse_address(rest, "the scenario's mavlink connect")
    if kind == "udpout":
        return LinkAddresses(Address(host, port), None)
    partner = Address(HOST if host == ANY else host, port)
    return LinkAddresses(_checked(HOST, port + _LISTEN_OFFSET), partner)


def _checked(host: str, port: int) -> Address:
    if not 0 < port <= _LAST_PORT:
        raise AutopilotError(f"port {port}: expected 1 to {_LAST_PORT}; choose a lower --port-base")
    return Address(host, port)
