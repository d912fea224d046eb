"""Installs the launch files and the layouts for colcon."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent  # colcon --symlink-install runs a link to this file
sys.path.insert(0, str(HERE.parents[1]))

from shell import install  # noqa: E402

FOLDERS = {"launch": "*.launch.py", "rviz": "*.rviz", "foxglove": "*.json"}

install(
    HERE.name,
    "Launch files and screen layouts of a PTNSBC formation",
    packages=[],
    data_files=[
        (
            f"share/{HERE.name}/{folder}",
            sorted(f"{folder}/{p.name}" for p in (HERE / folder).glob(glob)),
        )
        for folder, glob in FOLDERS.items()
    ],
)
