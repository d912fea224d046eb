"""Findings about this computer: what flights need and it lacks, and how to mend it."""

from __future__ import annotations

import ctypes
import os
import platform
import shutil
import socket
import sys
import time
from importlib.util import find_spec
from pathlib import Path

from ptnsbc_core.compile_cache import cache_root, source_digest
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import ros
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, Finding, Findings, judge
from ptnsbc_tools.library.flying import ScenarioLike, load

_LEAST_PYTHON, _NEXT_PYTHON = (3, 10), (3, 14)
_LEAST_FREE_B = 2_000_000_000
_UNSYNCHRONISED = 5  # TIME_ERROR of adjtimex(2)
_TIMEX_BYTES = 1024  # more than struct timex has
_WAKES = 100
_LATE_MS = 5.0  # half a control period at 100 Hz
_RANGE, _PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"
_TRANSPORTS = ("ROS_DOMAIN_ID", _RANGE, _PEERS, "RMW_IMPLEMENTATION")


def _machine() -> Findings:
    good = _LEAST_PYTHON <= sys.version_info[:2] < _NEXT_PYTHON and platform.system() == "Linux"
    value = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    advice = "" if good else "make setup PYTHON=python3.12"
    yield judge("platform", value, "Linux, Python 3.10 to 3.13", advice, ERROR)
    count, limit = len(os.sched_getaffinity(0)), ">= 4 for a fleet in real time"
    advice = "fly in lock-step (--lockstep), or in one process (ptnsbc simulate)"
    yield judge("cores", str(count), limit, advice if count < 4 else "")
    lateness_ms = []
    for _ in range(_WAKES):  # how late the kernel wakes a process that sleeps for a millisecond
        due_s = time.monotonic() + 1e-3
        time.sleep(1e-3)
        lateness_ms.append(1e3 * (time.monotonic() - due_s))
    late_ms = sorted(lateness_ms)[int(0.95 * _WAKES)]
    value, limit = f"{late_ms:.2f} ms late, 95 % of {_WAKES}", f"<= {_LATE_MS:g} ms"
    advice = "end other programs, or fly in lock-step" if late_ms > _LATE_MS else ""
    yield judge("timers", value, limit, advice)
    # The kernel says whether something keeps the clock right; a fleet on one host does not need it.
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    good, limit = (
        state not in (-1, _UNSYNCHRONISED),
        "synchronised, for fleets on several computers",
    )
    value = "synchronised" if good else "not synchronised, says the kernel"
    advice = "install chrony or start systemd-timesyncd; one host alone needs neither"
    yield judge("clock", value, limit, "" if good else advice)
    free = shutil.disk_usage(Path.cwd()).free
    value, limit = f"{free / 1e9:.1f} GB free here", f">= {_LEAST_FREE_B / 1e9:g} GB"
    advice = "record elsewhere: --bag DIR" if free < _LEAST_FREE_B else ""
    yield judge("disk", value, limit, advice)


def _middleware() -> Findings:
    from ptnsbc_nodes.runtime.environment import DomainError, reserved_domain

    try:
        with ros.required():
            import rclpy
            from rclpy.utilities import get_rmw_implementation_identifier

            name = str(get_rmw_implementation_identifier())
    except PtnsbcError as error:
        advice = "fly and judge without it: ptnsbc simulate, sweep, verify"
        level = WARNING if isinstance(error, ros.LibraryMissingError) else ERROR
        yield judge("middleware", str(error), "rclpy, and processes that hear it", advice, level)
        return
    value = f"{name}, rclpy from {Path(rclpy.__file__).parents[1]}"
    advice = "" if name == "rmw_fastrtps_cpp" else "unset RMW_IMPLEMENTATION"
    yield judge("middleware", value, "rmw_fastrtps_cpp, which is tested", advice)
    given = {key: os.environ[key] for key in _TRANSPORTS if os.environ.get(key)}
    shown = ", ".join(f"{key}={value}" for key, value in given.items()) or "nothing set"
    wide = given.get(_RANGE) in ("SUBNET", "SYSTEM_DEFAULT")
    advice = f"unset {_RANGE}: others could hear the fleet" if wide else ""
    yield judge("discovery", shown, f"this host alone, and {_PEERS}", advice)
    value, advice = "", ""
    try:
        with reserved_domain() as domain:
            value = f"{domain} is free"
    except (DomainError, OSError) as error:
        value, advice = str(error), "end other fleets"
    yield judge("domain", value, "one free ROS domain", advice, ERROR)


def _cache() -> Findings:
    root = cache_root()
    folder = root / source_digest()
    compiled = len(list(folder.glob("*"))) if folder.is_dir() else 0
    above = next(path for path in (root, *root.absolute().parents) if path.exists())
    writable = os.access(above, os.W_OK)
    value = f"{root}: {compiled} laws compiled" if compiled else f"{root}: nothing compiled yet"
    advice = "" if writable else "set PTNSBC_CACHE_DIR: the laws are compiled at every start"
    if writable and not compiled:
        advice = "the first flight takes half a minute more"
    yield Finding(WARNING if not writable else INFO, "cache", value, "a writable folder", advice)


def _libraries() -> Findings:
    for name, use, advice in (
        ("pymavlink", "bridges and stand-ins", 'pip install "ptnsbc[mavlink]"'),
        ("pandas", "to_pandas()", 'pip install "ptnsbc[tables]"'),
        ("tf2_msgs", "a live /tf; bags contain it", "make setup-messages"),
    ):
        value = "not installed"
        if find_spec(name) is not None:
            value, advice = "installed", ""
        yield Finding(INFO, name, value, f"only for {use}", advice)


def ports(scenario: Scenario) -> Findings:
    """The ports on which the bridges of a scenario listen, free or not."""
    for uav in scenario.uav_ids:
        connect = scenario.vehicle_link(uav).connect
        kind, _, rest = connect.partition(":")
        if kind != "udpin":
            continue
        address, _, port = rest.rpartition(":")
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
                one.bind((address, int(port)))
        except OSError as error:
            advice = f"end the program that has it, or set mavlink.vehicles.{uav}.connect"
            yield Finding(ERROR, f"port of UAV {uav}", f"{rest}: {error.strerror}", "free", advice)
        else:
            yield Finding(INFO, f"port of UAV {uav}", f"{rest} is free", "free", "")


def examine(scenario: ScenarioLike | None = None) -> list[Finding]:
    """The findings, errors first; with a scenario the ports of its bridges too."""
    looks = (_machine, _middleware, _cache, _libraries)
    found = [finding for look in looks for finding in look()]
    found += ports(load(scenario)) if scenario is not None else ()
    rank = {ERROR: 0, WARNING: 1, INFO: 2}
    return sorted(found, key=lambda one: rank[one.severity])
