"""A fleet of real processes over real UDP: take-off, formation, a UAV process killed, the operator's stop."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("pymavlink")

from ptnsbc_nodes.bag import read_bag

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ROOT = Path(__file__).resolve().parents[3]
PATIENCE_S = 240


def free_ports(count):
    """The first of `count` ports in a row that nobody listens at."""
    for first in range(15200, 15990, 10):
        with_room = []
        try:
            for offset in range(count):
                probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                with_room.append(probe)
                probe.bind(("127.0.0.1", first + offset))
            return first
        except OSError:
            continue
        finally:
            for probe in with_room:
                probe.close()
    raise AssertionError("no free ports from 15200 to 15990")


SCENARIO = """
extends: {base}
timing: {{duration_s: 60}}
mavlink:
  vehicles:
    1: {{connect: "udpin:127.0.0.1:{0}"}}
    2: {{connect: "udpin:127.0.0.1:{1}"}}
    3: {{connect: "udpin:127.0.0.1:{2}"}}
    4: {{connect: "udpin:127.0.0.1:{3}"}}
"""


class Program:
    """A command as a process of its own, and what it has said."""

    def __init__(self, module, *arguments, domain):
        self.lines = []
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", module, *map(str, arguments)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            cwd=ROOT,
        )
        self._watchdog = threading.Timer(PATIENCE_S, self.process.kill)
        self._watchdog.daemon = True
        self._watchdog.start()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stderr:
            self.lines.append(line.rstrip())

    def wait_for(self, *texts, patience_s=150):
        end = time.monotonic() + patience_s
        while not all(any(text in line for line in self.lines) for text in texts):
            assert time.monotonic() < end and self.process.poll() is None, self.lines
            time.sleep(0.05)

    def finish(self, number=None):
        if number is not None:
            self.process.send_signal(number)
        code = self.process.wait(PATIENCE_S)
        self._watchdog.cancel()
        return code


def pid_of(module, number, logs):
    """The process of one UAV of this fleet and of no other."""
    for entry in Path("/proc").iterdir():
        try:
            command = (entry / "cmdline").read_bytes().decode().replace("\0", " ")
        except OSError:
            continue
        if all(word in command for word in (module, f"--uav {number}", str(logs))):
            return int(entry.name)
    raise AssertionError(f"no {module} of UAV {number}")


def test_a_uav_process_killed_and_the_operators_stop(tmp_path, domain):
    first = free_ports(4)
    path = tmp_path / "four.yaml"
    base = ROOT / "scenarios" / "experiment_4.yaml"
    path.write_text(SCENARIO.format(*range(first, first + 4), base=base))
    command = "ptnsbc_tools.cli"
    stand_ins = Program(
        command, "autopilot", "--scenario", path, "--gcs", "", "--boot-time", "0.1",
        "--gnss", "perfect", "--param", "COM_OBL_RC_ACT=5", domain=domain,
    )  # fmt: skip
    logs = tmp_path / "logs"
    fleet = Program(
        "ptnsbc_nodes.fleet_node", "--scenario", path, "--backend", "mavlink", "--allow-arming",
        "--bag", tmp_path / "bag", "--log-dir", logs, domain=domain,
    )  # fmt: skip
    try:
        fleet.wait_for(*(f"bridge{i}: in formation" for i in range(1, 5)))
        os.kill(pid_of("ptnsbc_nodes.uav_node", 3, logs), signal.SIGKILL)
        fleet.wait_for("uav3 (pid ", "bridge3: no setpoints: ", patience_s=20)
        stop = Program(command, "stop", "--domain", domain, domain=domain)
        assert stop.finish() == 0, stop.lines
        fleet.wait_for(*(f"bridge{i}: done" for i in range(1, 5)), patience_s=90)
        assert fleet.finish() == 1  # one process died
    finally:
        for program in (fleet, stand_ins):
            if program.process.poll() is None:
                program.process.send_signal(signal.SIGINT)
        assert stand_ins.finish() in (0, 130), stand_ins.lines
        fleet.finish()
    bag = read_bag(tmp_path / "bag")
    assert bag.topics["/uav1/odom"].messages > 100
    legs = [message for message in bag.messages(["/formation/epoch"])]
    assert len(legs) == 2  # form, and the operator's landing
