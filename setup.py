"""The settings without a place in pyproject.toml: programs for `ros2 run`, and a build that forgets the earlier one."""

import sys
from pathlib import Path

from setuptools import setup

sys.path.insert(0, str(Path(__file__).resolve().parent / "ros2_ws"))

from shell import EditableToo, FreshBuild, WithPrograms

setup(
    cmdclass={"build_py": FreshBuild, "install_data": WithPrograms},
    distclass=EditableToo,
)
