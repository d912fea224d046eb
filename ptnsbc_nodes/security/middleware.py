"""The DDS Security of the middleware, and the settings that make a process insist on it."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ptnsbc_core.errors import PtnsbcError

if TYPE_CHECKING:  # environment needs this before anything is loaded
    from ptnsbc_sim.scenario import Scenario

KEYSTORE, ENCLAVE = "ROS_SECURITY_KEYSTORE", "ROS_SECURITY_ENCLAVE_OVERRIDE"
_ENFORCED = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
_LIBRARY = "librmw_fastrtps_shared_cpp.so"
_WITHOUT = b"have the security libraries"  # what a library that was built without it would say


class DdsSecurityError(PtnsbcError):
    """DDS Security was asked for, and cannot be had."""


def lacks_security() -> bool:
    """True if the installed rmw_fastrtps was built without DDS Security; False also for another middleware."""
    folders = [*map(Path, os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep))]
    for prefix in (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix):
        folders.append(Path(prefix) / "lib")
    found = next((path for folder in folders if (path := folder / _LIBRARY).is_file()), None)
    return found is not None and _WITHOUT in found.read_bytes()


def enforced(environment: Mapping[str, str]) -> dict[str, str]:
    """The settings with which every process refuses an unprotected start.

    Raises:
        DdsSecurityError: there is no keystore, or the middleware has no DDS Security.
    """
    keystore = environment.get(KEYSTORE, "")
    if not (Path(keystore) / "enclaves" / "governance.p7s").is_file() or not keystore:
        raise DdsSecurityError(
            f"security: required: {KEYSTORE}={keystore or '(unset)'}: expected the folder of a keystore, "
            "made by `ros2 security generate_artifacts` of what `ptnsbc network policy` prints"
        )
    if lacks_security():
        raise DdsSecurityError(
            "security: required: this ROS is built without DDS Security: expected another one, as from apt, "
            "or security: signed"
        )
    return dict(_ENFORCED)


def check_enforced(scenario: Scenario) -> None:
    """DdsSecurityError when this process would fly a scenario with `security: required` unprotected."""
    if scenario.security != "required":
        return
    enforced(os.environ)
    for name, value in _ENFORCED.items():
        if os.environ.get(name) != value:
            raise DdsSecurityError(f"security: required: {name}: expected {value}")
