"""Settings that ROS reads from the environment, set before rclpy starts; the user's own win."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_DEFAULTS = {
    # A fleet on one host; spread over hosts, the user widens it.
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    # Shared memory is no faster here, and a killed process leaves its segments behind.
    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
}


def prepare() -> None:
    """Fill in what is not set. With ROS from wheels rclpy.init() fails without it."""
    for name, value in _DEFAULTS.items():
        os.environ.setdefault(name, value)
    # The wheels put the ament index into the environment's prefix, but tell nobody.
    if (Path(sys.prefix) / "share" / "ament_index").is_dir():
        os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
