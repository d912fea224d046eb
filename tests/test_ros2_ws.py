"""The ROS workspace holds links to the packages at the root; these must hold, or fail aloud."""

import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SRC = ROOT / "ros2_ws" / "src"
LINKED = ["ptnsbc_core", "ptnsbc_sim", "ptnsbc_nodes", "ptnsbc_tools"]
ALL = [*LINKED, "ptnsbc_bringup"]
VERSION = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.M).group(1)


def run_setup(package: Path) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "setup.py", "--version"], cwd=package, capture_output=True, text=True
    )


@pytest.fixture
def copied_workspace(tmp_path):
    """A repository with nothing but one package, so that its link can be broken."""
    (tmp_path / "pyproject.toml").write_text('version = "9.8.7"\n')
    (tmp_path / "ptnsbc_core").mkdir()
    (tmp_path / "ptnsbc_core" / "__init__.py").touch()
    package = tmp_path / "ros2_ws" / "src" / "ptnsbc_core"
    shutil.copytree(SRC / "ptnsbc_core", package, symlinks=True)
    return package


@pytest.mark.parametrize("name", ALL)
def test_version_is_the_projects(name):
    result = run_setup(SRC / name)
    assert result.stdout.split()[-1] == VERSION, result.stderr


@pytest.mark.parametrize("name", LINKED)
def test_link_is_relative_and_leads_to_the_package(name):
    link = SRC / name / name
    assert link.is_symlink()
    assert str(link.readlink()) == f"../../../{name}"
    assert link.resolve() == ROOT / name


@pytest.mark.parametrize("name", ALL)
def test_package_xml(name):
    package = ET.parse(SRC / name / "package.xml").getroot()
    assert package.get("format") == "3"
    assert package.findtext("name") == name
    assert package.findtext("version") == VERSION
    assert package.findtext("license") == "Apache-2.0"
    assert package.findtext("export/build_type") == "ament_python"
    # colcon drops to a plain Python package, without a word, when this is not an address.
    assert re.fullmatch(r"[\w.]+@[\w.]+\.\w+", package.find("maintainer").get("email"))


def test_dependencies_point_down():
    for position, name in enumerate(LINKED):
        package = ET.parse(SRC / name / "package.xml").getroot()
        needed = {element.text for element in package.iter("exec_depend")}
        assert needed.isdisjoint(LINKED[position:]), name


def test_version_is_read_through_the_link(copied_workspace):
    assert run_setup(copied_workspace).stdout.split()[-1] == "9.8.7"


@pytest.mark.parametrize("target", ["../../../nowhere", None])
def test_broken_link_stops_the_build(copied_workspace, target):
    link = copied_workspace / "ptnsbc_core"
    link.unlink()
    if target is not None:
        link.symlink_to(target)
    result = run_setup(copied_workspace)
    assert result.returncode != 0
    assert "ln -sfn ../../../ptnsbc_core" in result.stderr
    assert "Traceback" not in result.stderr


def test_console_scripts_are_the_wheels():
    shells = (SRC / "ptnsbc_tools" / "setup.py").read_text()
    wheel = (ROOT / "pyproject.toml").read_text()
    assert "ptnsbc = ptnsbc_tools.cli:main" in shells
    assert 'ptnsbc = "ptnsbc_tools.cli:main"' in wheel


@pytest.mark.slow
def test_colcon_builds_every_package_as_ament_python(tmp_path):
    """The same script as `make colcon`, in a copy: builds in the checkout may run side by side."""
    if not (ROOT / ".venv" / "bin" / "colcon").exists():
        pytest.skip("colcon is not in .venv: make setup")
    shutil.copytree(
        ROOT / "ros2_ws",
        tmp_path / "ros2_ws",
        symlinks=True,
        ignore=shutil.ignore_patterns("build", "install", "log"),
    )
    for name in [".venv", "pyproject.toml", *LINKED]:
        (tmp_path / name).symlink_to(ROOT / name)
    result = subprocess.run(
        [tmp_path / "ros2_ws" / "check.sh"], capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0, result.stderr
    assert "all packages are ros.ament_python" in result.stdout
