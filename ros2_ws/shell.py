"""What the setup.py of every package here does alike, for colcon."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"


class FreshBuild(build_py):
    """Forgets what an earlier build left: a module that is gone would be installed again."""

    def run(self) -> None:
        for package in {name.partition(".")[0] for name in self.packages or ()}:
            shutil.rmtree(Path(self.build_lib) / package, ignore_errors=True)
        super().run()


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


def install_linked(here: Path, description: str, scripts: tuple[str, ...] = ()) -> None:
    """Install the package behind the link `here`/NAME, with its console scripts."""
    name = here.name
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
        entry_points={"console_scripts": list(scripts)},
    )
