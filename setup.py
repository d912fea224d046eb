"""What pyproject.toml cannot say: programs for `ros2 run`, and that a build forgets what an earlier one left."""

import sys
from pathlib import Path

from setuptools import setup

sys.path.insert(0, str(Path(__file__).resolve().parent / "ros2_ws"))

from shell import EditableToo, FreshBuild, WithPrograms

setup(
    cmdclass={"build_py": FreshBuild, "install_data": WithPrograms},
    distclass=EditableToo,
)
