"""What pyproject.toml cannot say: a build forgets what an earlier one left in build/."""

import sys
from pathlib import Path

from setuptools import setup

sys.path.insert(0, str(Path(__file__).resolve().parent / "ros2_ws"))

from shell import FreshBuild

setup(cmdclass={"build_py": FreshBuild})
