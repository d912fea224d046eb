"""Message packages beside the wheels of ROS, as `make setup-messages` and `make test` install them, or in wheels."""

from __future__ import annotations

import importlib
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[1]
BUILD = ROOT / "requirements" / "interfaces"
HOME = {"platlib": Path(sysconfig.get_path("platlib")), "data": Path(sys.prefix)}


@pytest.mark.slow
def test_a_wheel_holds_every_file_of_the_package(tmp_path: Path) -> None:
    pytest.importorskip("tf2_msgs")
    if shutil.which("g++") is None or not (HOME["platlib"] / "tf2_msgs").is_dir():
        pytest.skip("tf2_msgs is made where ROS comes from wheels and g++ is installed")
    command = [sys.executable, BUILD / "build.py", "--wheels", tmp_path, BUILD / "tf2_msgs"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    (wheel,) = tmp_path.glob("tf2_msgs-*.whl")
    held = set()
    for name in ZipFile(wheel).namelist():
        top, _, rest = name.partition("/")
        if top.endswith(".data"):
            held.add(HOME["data"] / rest.partition("/")[2])
        elif not top.endswith(".dist-info"):
            held.add(HOME["platlib"] / name)
    installed = [
        *HOME["data"].glob("lib/libtf2_msgs__*.so"),
        *HOME["data"].glob("share/tf2_msgs/**/*"),
        *HOME["platlib"].glob("tf2_msgs/**/*"),
    ]
    found = {path for path in installed if path.is_file() and "__pycache__" not in path.parts}
    assert found <= held
    assert all(path.is_file() for path in held)


def test_types_of_a_package_have_the_support_of_the_middleware() -> None:
    messages = pytest.importorskip("lab_msgs.msg", reason="make test builds it where g++ is")
    services = importlib.import_module("lab_msgs.srv")
    for kind in (messages.Vehicles, services.Fly):
        kind.__class__.__import_type_support__()
        assert kind.__class__._TYPE_SUPPORT is not None
    assert services.Fly.Request(id=3).id == 3


def test_a_package_that_is_not_there_is_named(tmp_path: Path) -> None:
    pytest.importorskip("rosidl_adapter")
    command = [sys.executable, BUILD / "build.py", "--wheels", tmp_path, tmp_path / "none"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == f"interfaces: {tmp_path / 'none'}: no package.xml\n"


@pytest.mark.parametrize(("kind", "needed"), [("srv", "service_msgs"), ("action", "action_msgs")])
def test_packages_that_each_service_and_action_needs_are_implied(
    tmp_path: Path, kind: str, needed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rosidl_adapter")
    monkeypatch.syspath_prepend(BUILD)
    (tmp_path / "package.xml").write_text("<package><name>mine</name></package>")
    depended_on = importlib.import_module("build").depended_on
    assert depended_on(tmp_path) == []
    (tmp_path / kind).mkdir()
    (tmp_path / kind / f"Do.{kind}").touch()
    assert {needed, "builtin_interfaces"} <= set(depended_on(tmp_path))
