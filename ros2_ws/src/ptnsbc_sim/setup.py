"""Installs ptnsbc_sim for colcon; the code is behind the link beside this file."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent  # colcon --symlink-install runs a link to this file
sys.path.insert(0, str(HERE.parents[1]))

from shell import install_linked  # noqa: E402


def _files(folder: str) -> list[str]:
    found = (HERE / folder).iterdir()
    return sorted(f"{folder}/{file.name}" for file in found if file.suffix in (".yaml", ".pcd"))


install_linked(
    HERE,
    "Plants, sensors, baselines and the headless swarm",
    # Where pip puts them too.
    data_files=[
        ("share/ptnsbc/scenarios", _files("scenarios")),
        ("share/ptnsbc/scenarios/families", _files("scenarios/families")),
    ],
)
