"""From options to stand-ins on their ports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from ptnsbc_nodes.autopilot.codec import AutopilotError, Codec, read_key
from ptnsbc_nodes.autopilot.px4 import Px4
from ptnsbc_nodes.autopilot.server import Address, Endpoint, Station
from ptnsbc_nodes.autopilot.starts import Fleet, Start, starts
from ptnsbc_nodes.autopilot.vehicle import Vehicle

KINDS: dict[str, type[Vehicle]] = {"px4": Px4}

PORT_BASE = 14540
"""PX4's: vehicle i sends to 14540 + i and listens on 14580 + i."""

_LISTEN_OFFSET = 40
_GCS_LISTEN_OFFSET = 4030  # 18570 + i, as PX4's simulation
_LAST_PORT = 65535


@dataclass(frozen=True)
class Network:
    """Who talks where."""

    host: str = "127.0.0.1"  # where the stand-ins listen
    port_base: int = PORT_BASE
    connect: str | None = None  # instead of the port pairs: udpin:HOST:PORT or udpout:HOST:PORT
    gcs: Address | None = field(default_factory=lambda: Address("127.0.0.1", 14550))
    key: str | None = None  # file; {n} stands for the system id


@dataclass(frozen=True)
class Options:
    """Everything asked for."""

    kind: str = "px4"
    fleet: Fleet = field(default_factory=Fleet)
    network: Network = field(default_factory=Network)
    boot_time: float = 1.0


def parse_address(text: str, what: str) -> Address:
    """HOST:PORT.

    Raises:
        AutopilotError: it is not.
    """
    host, colon, port = text.rpartition(":")
    if not colon or not host or not port.isdigit() or not 0 < int(port) <= _LAST_PORT:
        raise AutopilotError(f"{what} {text!r}: expected HOST:PORT, as 127.0.0.1:14550")
    return Address(host, int(port))


def stations(options: Options, t: float, say: Callable[[str], None]) -> list[Station]:
    """Vehicles with closed sockets, booted at t [s].

    Raises:
        AutopilotError: an option that cannot be.
    """
    if options.kind not in KINDS:
        raise AutopilotError(f"type {options.kind!r}: expected one of {', '.join(KINDS)}")
    return [_station(options, start, t, say) for start in starts(options.fleet)]


def _station(options: Options, start: Start, t: float, say: Callable[[str], None]) -> Station:
    network, system = options.network, start.system

    def tell(line: str) -> None:
        say(f"uav {system}: {line}")

    vehicle = KINDS[options.kind](system, start.body, t, boot_time=options.boot_time, say=tell)
    key = None
    if network.key is not None:
        key = read_key(Path(network.key.replace("{n}", str(system))))
    endpoints = [_companion(network, system, Codec(system, key=key, link_id=0))]
    if network.gcs is not None:
        listen = Address(network.host, network.port_base + _GCS_LISTEN_OFFSET + system - 1)
        codec = Codec(system, key=key, link_id=1)
        endpoints.append(Endpoint(_checked(listen), network.gcs, codec))
    return Station(vehicle, endpoints)


def _companion(network: Network, system: int, codec: Codec) -> Endpoint:
    step = system - 1
    if network.connect is None:
        base = network.port_base + step
        listen = Address(network.host, base + _LISTEN_OFFSET)
        return Endpoint(_checked(listen), _checked(Address(network.host, base)), codec)
    kind, _, rest = network.connect.partition(":")
    if kind not in ("udpin", "udpout"):
        raise AutopilotError(
            f"connect {network.connect!r}: expected udpin:HOST:PORT or udpout:HOST:PORT"
        )
    host, port = parse_address(rest, "connect")
    there = _checked(Address(host, port + step))
    if kind == "udpin":
        return Endpoint(there, None, codec)
    return Endpoint(Address("0.0.0.0", 0), there, codec)


def _checked(address: Address) -> Address:
    if not 0 < address.port <= _LAST_PORT:
        raise AutopilotError(
            f"port {address.port}: expected 1 to {_LAST_PORT}; choose a lower --port-base"
        )
    return address
