"""Installs the launch file and the layouts for colcon."""

import re
from pathlib import Path

from setuptools import setup

HERE = Path(__file__).resolve().parent  # colcon --symlink-install runs a link to this file
NAME = HERE.name
FOLDERS = {"launch": "*.launch.py", "rviz": "*.rviz", "foxglove": "*.json"}


def project_version() -> str:
    """Read the version from the pyproject.toml at the root of the repository."""
    project = HERE.parents[2] / "pyproject.toml"
    if not project.is_file():
        raise SystemExit(
            f"{project}: expected the pyproject.toml of ptnsbc; build inside its repository"
        )
    found = re.search(r'^version = "(.+)"$', project.read_text(encoding="utf-8"), re.MULTILINE)
    if found is None:
        raise SystemExit(f'{project}: expected a line version = "..."')
    return found.group(1)


def shared_files() -> list[tuple[str, list[str]]]:
    """Pair each folder under share/ with its files, as paths from here."""
    return [
        (f"share/{NAME}/{folder}", sorted(f"{folder}/{p.name}" for p in (HERE / folder).glob(glob)))
        for folder, glob in FOLDERS.items()
    ]


setup(
    name=NAME,
    version=project_version(),
    packages=[],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *shared_files(),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="The PTNSBC maintainers",
    maintainer_email="maintainers@example.org",
    description="Launch file and screen layouts of a PTNSBC formation",
    license="Apache-2.0",
)
