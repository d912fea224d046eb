"""Installs ptnsbc for colcon; the code is behind the link beside this file."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent  # colcon --symlink-install runs a link to this file
sys.path.insert(0, str(HERE.parents[1]))

from shell import install_linked  # noqa: E402

install_linked(HERE, "The library: load, check, fly, sweep, read and judge from Python")
