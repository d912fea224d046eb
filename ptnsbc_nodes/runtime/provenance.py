"""Versions and the commit of the code that flew, for the metadata of a bag."""

from __future__ import annotations

import argparse
import platform
import re
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, distributions, version
from pathlib import Path

_OURS = ("ptnsbc", "ptnsbc_nodes")  # as pip and as colcon install it
_PACKAGES = ("numpy", "numba", "ros-rclpy", "ros-rmw-fastrtps-cpp")
_ROOT = Path(__file__).resolve().parents[2]
_PATIENCE_S = 5.0


@cache
def provenance() -> dict[str, str]:
    """Versions of all packages that the result depends on, and the commit when this is a checkout."""
    facts = {"python": platform.python_version(), "machine": platform.machine()}
    facts["ptnsbc"] = own_version()
    for name in _PACKAGES:
        try:
            facts[name] = version(name)
        except PackageNotFoundError:  # ROS from apt, or run from a checkout
            continue
    commit = _commit()
    return facts | ({"commit": commit} if commit else {})


def own_version() -> str:
    """The version of the code that runs, also where other versions are installed.

    In a checkout it is that of pyproject.toml, because an installation may have left old metadata there;
    elsewhere it is that of the distribution in the folder of the code.
    """
    project = _ROOT / "pyproject.toml"
    if project.is_file():
        found = re.search(r'^version = "(.+)"$', project.read_text(encoding="utf-8"), re.MULTILINE)
        return found[1] if found else "unknown"
    for name in _OURS:
        for distribution in distributions(name=name, path=[str(_ROOT)]):
            return distribution.version
    return "unknown"


def add_version(parser: argparse.ArgumentParser) -> None:
    """Add --version, the same for all programs."""
    parser.add_argument("--version", action="version", version=f"ptnsbc {own_version()}")


def _commit() -> str:
    if not (_ROOT / ".git").exists():
        return ""
    command = ["git", "-C", str(_ROOT), "describe", "--always", "--abbrev=40", "--dirty"]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_PATIENCE_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
