"""Installs ptnsbc_sim for colcon; the code is behind the link beside this file."""

import re
from pathlib import Path

from setuptools import find_packages, setup

HERE = Path(__file__).resolve().parent  # colcon --symlink-install runs a link to this file
NAME = HERE.name


def project_version() -> str:
    """Read the version from the pyproject.toml that the linked package lives beside."""
    package = HERE / NAME
    project = package.resolve().parent / "pyproject.toml"
    if not (package / "__init__.py").is_file() or not project.is_file():
        # Without this, a link to nowhere builds without a complaint, and empty.
        raise SystemExit(
            f"{package}: expected a link to ../../../{NAME}, which does not lead there; "
            f"restore it with: ln -sfn ../../../{NAME} {package}"
        )
    found = re.search(r'^version = "(.+)"$', project.read_text(encoding="utf-8"), re.MULTILINE)
    if found is None:
        raise SystemExit(f'{project}: expected a line version = "..."')
    return found.group(1)


setup(
    name=NAME,
    version=project_version(),
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["py.typed", "*.json", "*.yaml", "assets/*", "profiles/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="The PTNSBC maintainers",
    maintainer_email="maintainers@example.org",
    description="Plants, sensors, baselines and the headless swarm",
    license="Apache-2.0",
)
