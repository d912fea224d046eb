"""Fast DDS profiles by which processes find each other: for one host, and for known computers.

The templates lie in `profiles/`; this module fills them in. None of them uses multicast, so that no packet
reaches a network that the user has not named.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from string import Template
from xml.etree import ElementTree

from ptnsbc_core.errors import PtnsbcError

LOOPBACK = "127.0.0.1"
PROCESSES = 32
"""The number of processes that are looked for on each host by default."""

_WRITERS = "writers.xml"  # not on one host, where no packet is lost and each request costs time
_MOST_PROCESSES = 120  # a domain has 250 ports, two for each process


class NetworkError(PtnsbcError):
    """A network that no fleet can fly over."""


def localhost(processes: int) -> str:
    """The profile of a fleet on this host: no packet leaves it, and no packet from outside is heard."""
    return _peers((LOOPBACK,), processes, "A fleet on one host")


def static_peers(addresses: Sequence[str], processes: int = PROCESSES) -> str:
    """The profile of a fleet on these computers, by addresses or names; the same file for all of them.

    `processes` are looked for on each computer.
    """
    if not addresses:
        raise NetworkError("no computer named: expected the address of each computer of the fleet")
    if not 1 <= processes <= _MOST_PROCESSES:
        raise NetworkError(
            f"{processes} processes on each computer: expected 1 to {_MOST_PROCESSES}, "
            "as many as a domain has ports for"
        )
    hosts = dict.fromkeys((LOOPBACK, *map(resolved, addresses)))
    title = f"A fleet on {', '.join(addresses)}"
    return _peers(tuple(hosts), processes, title, _shipped(_WRITERS))


def resolved(address: str) -> str:
    """The IPv4 address behind a name; an address stays what it is."""
    try:
        return str(ipaddress.IPv4Address(address))
    except ValueError:
        pass
    try:
        return socket.gethostbyname(address)
    except OSError as error:
        raise NetworkError(
            f"{address!r}: {error.strerror or error}: expected an IPv4 address or a known name"
        ) from None


def checked(profile: Path) -> Path:
    """The absolute path of a profile that can be read.

    Fast DDS ignores a profile that it cannot read and uses multicast instead. So this refuses such a profile.
    """
    expected = "expected a profile, as `ptnsbc network` writes it"
    try:
        root = ElementTree.parse(profile).getroot()
    except (OSError, ElementTree.ParseError) as error:
        reason = getattr(error, "strerror", None) or error
        raise NetworkError(f"{profile}: {reason}: {expected}") from None
    if not any(element.tag.rpartition("}")[2] == "participant" for element in root.iter()):
        raise NetworkError(f"{profile}: no <participant> in it: {expected}")
    return profile.resolve()


def _peers(hosts: Sequence[str], processes: int, title: str, writers: str = "") -> str:
    return _filled(
        "peers.xml",
        title=title,
        processes=str(processes),
        writers=writers,
        interfaces="".join(f"<address>{host}</address>" for host in hosts),
        peers="".join(
            f"<locator><udpv4><address>{host}</address></udpv4></locator>" for host in hosts
        ),
    )


def _filled(template: str, **values: str) -> str:
    return Template(_shipped(template)).substitute(values)


def _shipped(name: str) -> str:
    file = files("ptnsbc_nodes.runtime").joinpath("profiles", name)
    return file.read_text(encoding="utf-8").rstrip("\n")
