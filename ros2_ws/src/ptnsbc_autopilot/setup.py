"""Installs ptnsbc_autopilot for colcon; the code is behind the link beside this file."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent  # colcon --symlink-install runs a link to this file
sys.path.insert(0, str(HERE.parents[1]))

from shell import install_linked  # noqa: E402

install_linked(
    HERE,
    "Stand-in flight controllers: MAVLink around a simulated quadrotor",
)
