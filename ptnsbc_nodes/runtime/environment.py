"""Settings of a process before rclpy starts: environment variables, scheduling, and a free ROS domain.

A variable that the user has set wins.
"""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
from collections.abc import Iterator, MutableMapping
from contextlib import contextmanager, suppress
from importlib.resources import files
from pathlib import Path
from string import Template

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.launcher import PARENT, stay_with_launcher

_DEFAULTS = {
    # A fleet on one host. The user widens it for more hosts.
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    # Shared memory is no faster here, and a killed process leaves its segments behind.
    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
}
# Our arrays are small. A library of linear algebra starts threads for large ones, and they spin while they wait.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
_RMW = "rmw_fastrtps_cpp"
_SPARE_PEERS = 12  # for viewers, a command line, a second recorder
_DOMAINS = range(1, 102)  # above, the ports reach into those the system hands out
# A launcher reserves a domain by the TCP port of this number plus the domain's. ROS's domain_coordinator does the same
# for the tests of ROS packages.
_FIRST_LOCK = 32768
_LAST_DOMAIN = 232  # the ports of the next one do not exist
_FIRST_PARTICIPANTS = 3
_LOADS = "get_rmw_implementation_identifier"
_SERVER_PORT = 11811  # of Fast DDS, where none is named
_REFUSAL_S = 0.2  # in which a host says that nobody has a port
_LIBRARY = "librmw_fastrtps_shared_cpp.so"
_WITHOUT = (
    b"have the security libraries"  # what a library that was built without DDS Security would say
)


class DomainError(PtnsbcError):
    """No usable ROS domain."""


class NetworkError(PtnsbcError):
    """A network that no fleet can fly over."""


class DdsSecurityError(PtnsbcError):
    """DDS Security was asked for, and cannot be had."""


def lacks_security() -> bool:
    """True if the installed rmw_fastrtps was built without DDS Security; False also for another middleware."""
    folders = [*map(Path, os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep))]
    for prefix in (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix):
        folders.append(Path(prefix) / "lib")
    found = next((path for folder in folders if (path := folder / _LIBRARY).is_file()), None)
    return found is not None and _WITHOUT in found.read_bytes()


def prepare() -> None:
    """Set the variables that are not set. With ROS from wheels rclpy.init() fails without them.

    Raises:
        DdsSecurityError: `ROS_SECURITY_ENABLE` is true, and the middleware has no DDS Security.
        DomainError: `ROS_DOMAIN_ID` is no domain. The middleware would end the process.
    """
    named_domain()
    if os.environ.get("ROS_SECURITY_ENABLE") == "true" and lacks_security():
        # Without a keystore rcl would go on unprotected; with one it raises from the first node.
        raise DdsSecurityError(
            "ROS_SECURITY_ENABLE=true: this ROS is built without DDS Security, as the wheels are: expected it unset"
            " (security: signed in the scenario seals the messages), or another ROS"
        )
    wheels = (Path(sys.prefix) / "share" / "ament_index").is_dir()
    stay_with_launcher()
    for name, value in _DEFAULTS.items():
        os.environ.setdefault(name, value)
    # The wheels put the ament index into the environment's prefix, but do not set the variable.
    if wheels:
        os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)


def refuse_lonely_middleware() -> None:
    """Raise NetworkError for variables with which the middleware ends the process, or hears nobody.

    For commands and launchers: a node that boots before its discovery server waits for it.
    """

    def refuse(name: str, why: str) -> NetworkError:
        return NetworkError(f"{name}={os.environ[name]}: {why}")

    if os.environ.get("RMW_IMPLEMENTATION", _RMW) != _RMW:
        # It ends the process that loads it: another one tries.
        command = [sys.executable, "-c", f"from rclpy.utilities import {_LOADS} as load; load()"]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            raise refuse("RMW_IMPLEMENTATION", f"this ROS has no such middleware: expected {_RMW}")
    if os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "OFF":
        why = "processes would not find each other: expected LOCALHOST, or it unset"
        raise refuse("ROS_AUTOMATIC_DISCOVERY_RANGE", why)
    servers = [
        one
        for one in os.environ.get("ROS_DISCOVERY_SERVER", "").split(";")
        if one and "[" not in one
    ]
    if servers and not any(map(_listens, servers)):
        why = "nobody listens there: expected ADDRESS:PORT of a running server, or it unset"
        raise refuse("ROS_DISCOVERY_SERVER", why)
    for peer in filter(None, os.environ.get("ROS_STATIC_PEERS", "").split(";")):
        try:
            socket.getaddrinfo(peer, None, socket.AF_INET)
        except OSError:
            why = f"{peer} is no known host: expected names or IPv4 addresses, or it unset"
            raise refuse("ROS_STATIC_PEERS", why) from None


def _listens(server: str) -> bool:
    """False if the host of a discovery server, ADDRESS or ADDRESS:PORT, answers that nobody has its port."""
    address, _, port = server.partition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.settimeout(_REFUSAL_S)
        try:
            probe.connect((address, int(port or _SERVER_PORT)))
            probe.send(b"")
            probe.recv(1)
        except TimeoutError:
            return True
        except (OSError, ValueError, OverflowError):  # also an address that is none
            return False
    return True


def one_thread(environment: MutableMapping[str, str]) -> None:
    """Set the variables by which the libraries of linear algebra, once they are loaded, work without threads."""
    for name in ONE_THREAD:
        environment.setdefault(name, "1")


def prefer_throughput() -> None:
    """For lock-step: a process that a message wakes does not interrupt the sender.

    Six processes wake each other at every message, and each costs less when it finishes its work first
    (`bench --only fleets`). The recorder does not use this: it would fall behind. Without the right to
    change the scheduling the process works all the same.
    """
    _schedule(os.SCHED_BATCH, 0)


def prefer_punctuality(*, after_vehicles: bool = False) -> bool:
    """For vehicles in real time, and for what records them: real-time scheduling (round robin), before other programs.

    A setpoint that waits half a second for a compiler on the same host ends the flight of a real vehicle, and a
    simulated world that is late makes all odometry stale at once. The kernel keeps a twentieth of the time for all
    other programs.

    Returns False without the right to change the scheduling; the process works all the same.
    """
    return _schedule(os.SCHED_RR, os.sched_get_priority_min(os.SCHED_RR) + (not after_vehicles))


def _schedule(policy: int, priority: int) -> bool:
    """Set the scheduling policy of all threads of this process: a node has started some already."""
    try:
        for thread in os.listdir("/proc/self/task"):
            with suppress(ProcessLookupError):  # the thread has just ended
                os.sched_setscheduler(int(thread), policy, os.sched_param(priority))
    except OSError:
        return False
    return True


def for_children(domain: int, processes: int, folder: Path) -> dict[str, str]:
    """The environment of the processes of a fleet; writes their profile of Fast DDS into `folder`."""
    prepare()
    refuse_lonely_middleware()
    child = dict(os.environ)
    child[PARENT] = str(os.getpid())
    child["ROS_DOMAIN_ID"] = str(domain)
    one_thread(child)
    # `-m ptnsbc_nodes...` must find the same code, installed or not.
    root = str(Path(__file__).resolve().parents[2])
    child["PYTHONPATH"] = os.pathsep.join(filter(None, (root, child.get("PYTHONPATH"))))
    if child.get("RMW_IMPLEMENTATION", _RMW) != _RMW or child.keys() & set(PROFILES):
        return child
    elsewhere = child.keys() & {"ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER"}
    alone = child["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST" and not elsewhere
    # LOCALHOST of rmw_fastrtps probes 32 participants only, and always uses shared memory. The profile of one host
    # does the same with as many peers as there are, and with UDP alone. That of a network leaves discovery to the user.
    template = files("ptnsbc_nodes.runtime") / "profiles" / f"{'host' if alone else 'network'}.xml"
    text = Template(template.read_text(encoding="utf-8"))
    profile = folder / "dds.xml"
    profile.write_text(text.substitute(processes=processes + _SPARE_PEERS), encoding="utf-8")
    child[PROFILES[0]] = str(profile)
    if alone:  # with any other value rmw_fastrtps would override the profile
        child["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
    return child


def named_domain() -> int:
    """The user's ROS_DOMAIN_ID, 0 by default; DomainError when it is none."""
    given = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (
        given.isdecimal() and given.isascii() and len(given) < 4 and int(given) <= _LAST_DOMAIN
    ):
        raise DomainError(f"ROS_DOMAIN_ID={given[:20]}: expected a number from 0 to {_LAST_DOMAIN}")
    return int(given)


@contextmanager
def reserved_domain() -> Iterator[int]:
    """The user's ROS_DOMAIN_ID, or a free domain that no other fleet takes inside the `with`."""
    if "ROS_DOMAIN_ID" in os.environ:
        yield named_domain()
    else:
        with free_domain() as domain:
            yield domain


@contextmanager
def free_domain() -> Iterator[int]:
    """A domain that no other fleet and no test of ROS takes inside the `with`, whatever ROS_DOMAIN_ID says."""
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        # The kernel frees the port however this process ends.
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as lock:
            if _takes(lock, _FIRST_LOCK + domain) and _is_unused(domain):
                yield domain
                return
    raise DomainError("every ROS domain from 1 to 101 is in use: set ROS_DOMAIN_ID")


def flying_domains() -> list[int]:
    """The domains that launchers of this host have reserved, and in which processes are."""
    flying = []
    for domain in _DOMAINS:
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as lock:
            if not _is_unused(domain) and not _takes(lock, _FIRST_LOCK + domain):
                flying.append(domain)
    return flying


def _takes(end: socket.socket, port: int) -> bool:
    """Bind a socket; False when the port is in use."""
    try:
        end.bind(("", port))
    except OSError:
        return False
    return True


def _is_unused(domain: int) -> bool:
    """True if the ports of the first participants of the domain are free."""
    for participant in range(_FIRST_PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            if not _takes(probe, 7400 + 250 * domain + 10 + 2 * participant):
                return False
    return True
