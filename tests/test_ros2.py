"""Flights by ROS's own `ros2 launch`, where it is installed: how they end, and that nothing outlives them."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
psutil = pytest.importorskip("psutil")

ROOT = Path(__file__).resolve().parents[1]
BRINGUP = ROOT / "ros2_ws" / "src" / "ptnsbc_bringup"
PATIENCE_S = 240.0  # the first flight compiles the laws
NO_ROS2 = "the `ros2` program is not installed: it comes with ROS from apt and has no wheel"

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("ros2") is None, reason=NO_ROS2),
]


@pytest.fixture
def overlay(tmp_path):
    """A prefix with the packages that the launch file names, as colcon would install them."""
    prefix = tmp_path / "prefix"
    packages = prefix / "share" / "ament_index" / "resource_index" / "packages"
    packages.mkdir(parents=True)
    for name in ("ptnsbc_bringup", "ptnsbc_tools"):
        (packages / name).touch()
    (prefix / "share" / "ptnsbc_bringup").symlink_to(BRINGUP)
    program = prefix / "lib" / "ptnsbc_tools" / "ptnsbc"
    program.parent.mkdir(parents=True)
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m ptnsbc_tools "$@"\n')
    program.chmod(0o755)
    return prefix


class Launched:
    """`ros2 launch FILE` as a process, and all that it has started."""

    def __init__(self, prefix: Path, file: Path, *arguments: str) -> None:
        paths = f"{prefix}:{os.environ.get('AMENT_PREFIX_PATH', '')}"
        self.process = subprocess.Popen(
            ["ros2", "launch", str(file), *arguments],
            env={**os.environ, "AMENT_PREFIX_PATH": paths, "PYTHONPATH": _with_us()},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.lines: list[str] = []
        self._watchdog = threading.Timer(PATIENCE_S, self.process.kill)
        self._watchdog.daemon = True
        self._watchdog.start()

    def wait_for(self, text: str) -> None:
        for line in self.process.stdout:
            self.lines.append(line.rstrip())
            if text in line:
                return
        raise AssertionError(f"never said {text!r}: {self.lines}")

    def started(self) -> list:
        return psutil.Process(self.process.pid).children(recursive=True)

    def finish(self) -> int:
        self.lines += self.process.communicate()[0].splitlines()
        self._watchdog.cancel()
        return self.process.returncode

    def said(self, text: str) -> bool:
        return any(text in line for line in self.lines)


def _with_us() -> str:
    return os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))


def _which(processes, name):
    (found,) = [one for one in processes if name in " ".join(one.cmdline())]
    return found


KINDS = {  # what is killed: words of its command line, and whether launch then fails
    "a UAV": ("--uav 3", True),
    "the sim": ("ptnsbc_nodes.sim.sim_main", True),
    "the recorder": ("ptnsbc_nodes.recording.recorder_main", True),
    "the launcher": ("-m ptnsbc_tools fleet", True),
}


@pytest.mark.parametrize("killed", [None, *KINDS, "launch itself", "Ctrl-C"])
def test_whatever_ends_a_flight_nothing_outlives_it(overlay, tmp_path, killed):
    flight = Launched(
        overlay, BRINGUP / "launch" / "fleet.launch.py", "scenario:=paper_5", "lockstep:=true",
        "duration:=12", f"record:={tmp_path / 'bag'}",
    )  # fmt: skip
    flight.wait_for("sim: ")
    started = flight.started()
    assert len(started) >= 8, "five UAVs, sim, recorder, launcher"
    if killed in KINDS:
        _which(started, KINDS[killed][0]).kill()
    elif killed == "launch itself":
        flight.process.kill()
    elif killed == "Ctrl-C":
        flight.process.send_signal(signal.SIGINT)
    code = flight.finish()
    gone, left = psutil.wait_procs(started, timeout=30.0)
    assert not left, "\n".join(flight.lines)
    assert len(gone) == len(started)
    if killed is None:
        assert code == 0
        assert flight.said("Verdict: met"), flight.lines
    elif killed in KINDS:
        assert (code != 0) is KINDS[killed][1], flight.lines


def test_two_fleets_in_one_launch_and_one_domain(overlay, tmp_path):
    file = tmp_path / "two.launch.py"
    file.write_text(
        f"""
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource as Source


def generate_launch_description():
    fleets = {{"blue": "7", "red": "14"}}
    return LaunchDescription([
        IncludeLaunchDescription(
            Source("{BRINGUP / "launch" / "fleet.launch.py"}"),
            launch_arguments={{
                "scenario": "paper_5", "lockstep": "true", "namespace": name, "duration": duration,
            }}.items(),
        )
        for name, duration in fleets.items()
    ])
"""
    )
    flight = Launched(overlay, file)
    assert flight.finish() == 0, flight.lines
    verdicts = [line for line in flight.lines if "Verdict:" in line]
    assert len(verdicts) == 2
    assert all("met" in line for line in verdicts), verdicts
