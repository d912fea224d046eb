"""The ROS workspace holds links to the packages at the root; these must hold, or fail aloud."""

import ast
import importlib
import importlib.util
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

ROOT = Path(__file__).resolve().parents[1]
SRC = ROOT / "ros2_ws" / "src"
LINKED = [
    "ptnsbc_core",
    "ptnsbc_io",
    "ptnsbc_sim",
    "ptnsbc_autopilot",
    "ptnsbc_nodes",
    "ptnsbc_tools",
    "ptnsbc",
]
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
    shutil.copy(ROOT / "ros2_ws" / "shell.py", tmp_path / "ros2_ws")
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


UBUNTU = {
    "hypothesis": "python3-hypothesis",
    "matplotlib": "python3-matplotlib",
    "numpy": "python3-numpy",
    "psutil": "python3-psutil",
    "pytest": "python3-pytest",
    "scipy": "python3-scipy",
    "serial": "python3-serial",
    "yaml": "python3-yaml",
}
"""The rosdep keys of modules that Ubuntu 24.04 has; all other names are packages of ROS, or in the lock."""
IN_THE_LOCK = {
    "arro3", "cmaes", "distributed", "laspy", "llvmlite", "lz4", "mcap", "numba", "pyarrow", "pydantic",
    "pydantic_core", "pymavlink", "rich", "rosbags", "typer", "websockets", "zstandard",
}  # fmt: skip


def imported(folder: Path) -> set[str]:
    """Packages outside the standard library and the lock that a folder imports, as rosdep names them."""
    found: set[str] = set()
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(node.module.partition(".")[0])
    return {UBUNTU.get(name, name) for name in found - sys.stdlib_module_names - IN_THE_LOCK}


def declared(name: str, kind: str) -> set[str]:
    package = ET.parse(SRC / name / "package.xml").getroot()
    return {element.text for element in package.iter(kind)}


@pytest.mark.parametrize("name", LINKED)
def test_what_a_package_imports_is_a_dependency(name):
    assert imported(ROOT / name) - {name} <= declared(name, "exec_depend")


@pytest.mark.parametrize("name", LINKED)
def test_what_the_tests_of_a_package_import_is_a_dependency(name):
    own = {path.stem for folder in ("tests", "examples") for path in (ROOT / folder).rglob("*.py")}
    own |= {path.name for path in (ROOT / "tests" / "messages").iterdir()}
    own |= {"bench", "docs", "tests"}
    needed = imported(ROOT / "tests" / name.removeprefix("ptnsbc_")) - own - set(LINKED)
    assert needed <= declared(name, "exec_depend") | declared(name, "test_depend")


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


def load_shell():
    spec = importlib.util.spec_from_file_location("ros2_ws_shell", ROOT / "ros2_ws" / "shell.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SHELL = load_shell()


def entry_points() -> list[tuple[str, str, str]]:
    """Package, program and function of every program."""
    return [
        (package, program, target)
        for package, programs in SHELL.PROGRAMS.items()
        for program, target in programs.items()
    ]


def test_the_command_line_is_the_wheels():
    wheel = (ROOT / "pyproject.toml").read_text()
    assert f'ptnsbc = "{SHELL.PROGRAMS["ptnsbc_tools"]["ptnsbc"]}"' in wheel


def test_launch_files_and_ptnsbc_node_know_every_program():
    from ptnsbc_nodes.fleet.child_process import EXECUTABLES
    from ptnsbc_tools.commands.network import node

    nodes = SHELL.PROGRAMS["ptnsbc_nodes"]
    assert {name: f"{module}:main" for module, name in EXECUTABLES.items()} == nodes
    kind = get_type_hints(node)["name"]
    assert set(get_args(kind)) == set(nodes)


def test_pip_writes_what_ros2_run_finds(tmp_path):
    """Without the rest of an installation: ros2_ws/fly.sh compares whole ones."""
    distribution = SHELL.EditableToo({"name": "ptnsbc", "data_files": [("share/x", [])]})
    assert distribution.has_data()  # what `pip install -e` asks
    command = SHELL.WithPrograms(distribution)
    command.install_dir = str(tmp_path / "prefix")
    command.run()
    (tmp_path / "prefix" / "bin").mkdir()
    pips = tmp_path / "prefix" / "bin" / "ptnsbc"
    pips.write_text('#!/bin/sh\nprintf "%s " "$@"\n')
    pips.chmod(0o755)
    for package, program, _ in entry_points():
        place = tmp_path / "prefix" / "lib" / package / program
        assert str(place) in command.get_outputs()
        said = subprocess.run([place, "--uav", "a b"], capture_output=True, text=True, check=True)
        before = f"network node {program} " if package == "ptnsbc_nodes" else ""
        assert said.stdout == f"{before}--uav a b "


@pytest.mark.parametrize(("package", "program", "target"), entry_points())
def test_entry_points_lead_to_a_function(package, program, target):
    if package == "ptnsbc_nodes":
        pytest.importorskip("rclpy")
    module, _, function = target.partition(":")
    assert module.split(".")[0] == package
    assert callable(getattr(importlib.import_module(module), function, None)), program
