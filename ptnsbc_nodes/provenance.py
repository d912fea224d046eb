"""What flew: versions and the commit, for the metadata of a bag."""

from __future__ import annotations

import platform
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = ("ptnsbc", "numpy", "numba", "ros-rclpy", "ros-rmw-fastrtps-cpp")
_ROOT = Path(__file__).resolve().parent.parent
_PATIENCE_S = 5.0


@cache
def provenance() -> dict[str, str]:
    """Versions of what the result depends on, and the commit when this is a checkout."""
    facts = {"python": platform.python_version(), "machine": platform.machine()}
    for name in _PACKAGES:
        try:
            facts[name] = version(name)
        except PackageNotFoundError:  # ROS from apt, or run from a checkout
            continue
    commit = _commit()
    return facts | ({"commit": commit} if commit else {})


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
