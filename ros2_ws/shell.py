"""The common part of the setup.py of every package here, for colcon."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

from setuptools import Distribution, find_packages, setup
from setuptools.command.build_py import build_py

from distutils.command.install_data import install_data  # isort: skip  (setuptools provides it)

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"

PROGRAMS = {
    "ptnsbc_nodes": {
        "uav": "ptnsbc_nodes.uav.uav_main:main",
        "sim": "ptnsbc_nodes.sim.sim_main:main",
        "recorder": "ptnsbc_nodes.recording.recorder_main:main",
        "bridge": "ptnsbc_nodes.bridge.bridge_main:main",
        "coordinator": "ptnsbc_nodes.fleet.coordinator_main:main",
    },
    "ptnsbc_tools": {"ptnsbc": "ptnsbc_tools.__main__:main"},
}
"""The programs that `ros2 run` finds in each package, made by colcon or by pip: name and function."""

# pip makes bin/ptnsbc, with its Python; names as plain as `sim` do not belong beside it.
_BESIDE_PIPS = """#!/bin/sh
exec "$(dirname -- "$0")/../../bin/ptnsbc"{words} "$@"
"""


class FreshBuild(build_py):
    """Forgets what an earlier build left: a module that is gone would be installed again."""

    def run(self) -> None:
        for package in {name.partition(".")[0] for name in self.packages or ()}:
            shutil.rmtree(Path(self.build_lib) / package, ignore_errors=True)
        super().run()


class WithPrograms(install_data):
    """Also writes what makes an environment of pip's one that `ros2 run` finds the programs in."""

    def run(self) -> None:
        super().run()
        for package, programs in PROGRAMS.items():
            folder = Path(self.install_dir) / "lib" / package
            folder.mkdir(parents=True, exist_ok=True)
            for name in programs:
                words = f" network node {name}" if package == "ptnsbc_nodes" else ""
                program = folder / name
                program.write_text(_BESIDE_PIPS.format(words=words), encoding="utf-8")
                program.chmod(0o755)
                self.outfiles.append(str(program))


class EditableToo(Distribution):
    """`pip install -e` asks for this before it installs data files, and a plain Distribution has no answer."""

    def has_data(self) -> bool:
        return bool(self.has_data_files())


def project_version() -> str:
    """The version in the pyproject.toml at the root of the repository."""
    if not PROJECT.is_file():
        raise SystemExit(
            f"{PROJECT}: expected the pyproject.toml of ptnsbc; build inside its repository"
        )
    found = re.search(r'^version = "(.+)"$', PROJECT.read_text(encoding="utf-8"), re.MULTILINE)
    if found is None:
        raise SystemExit(f'{PROJECT}: expected a line version = "..."')
    return found.group(1)


def install(name: str, description: str, *, packages: list[str], **options: Any) -> None:
    """Install one package of the workspace."""
    data_files = [
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (f"share/{name}", ["package.xml"]),
        *options.pop("data_files", ()),
    ]
    setup(
        name=name,
        version=project_version(),
        packages=packages,
        package_data={"": ["py.typed", "*.json", "*.yaml", "assets/*", "profiles/*"]},
        data_files=data_files,
        cmdclass={"build_py": FreshBuild},
        install_requires=["setuptools"],
        zip_safe=False,
        maintainer="The PTNSBC maintainers",
        maintainer_email="maintainers@example.org",
        description=description,
        license="Apache-2.0",
        **options,
    )


def install_linked(here: Path, description: str, **options: Any) -> None:
    """Install the package behind the link `here`/NAME, with its programs."""
    name = here.name
    programs = PROGRAMS.get(name, {})
    package = here / name
    if not (package / "__init__.py").is_file():
        # Without this, a link to nowhere builds without a complaint, and empty.
        raise SystemExit(
            f"{package}: expected a link to ../../../{name}, which does not lead there; "
            f"restore it with: ln -sfn ../../../{name} {package}"
        )
    install(
        name,
        description,
        packages=find_packages(where=str(here), include=[name, f"{name}.*"]),
        entry_points={"console_scripts": [f"{key} = {main}" for key, main in programs.items()]},
        **options,
    )
