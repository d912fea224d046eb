"""A flight by the launch file: its processes started for real, by a stand-in for ROS's launch."""

from __future__ import annotations

import importlib.util
import os
import runpy
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from ptnsbc_io.bag import read_bag
from ptnsbc_nodes.fleet.child_process import EXECUTABLES
from ptnsbc_nodes.runtime.signals import signals_blocked

ROOT = Path(__file__).resolve().parents[3]
BRINGUP = ROOT / "ros2_ws" / "src" / "ptnsbc_bringup"
MODULES = {name: module for module, name in EXECUTABLES.items()}
PATIENCE_S = 180.0

pytestmark = [pytest.mark.ros, pytest.mark.slow]


@pytest.fixture
def api(monkeypatch):
    place = ROOT / "tests" / "support" / "launch_stand_in.py"
    spec = importlib.util.spec_from_file_location("launch_stand_in", place)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.install(monkeypatch, BRINGUP)
    return module


class Launched:
    """The entities of a launch file, as launch runs them: nodes, and what the end of one leads to."""

    def __init__(self, api, domain, logs):
        self._api, self._logs = api, logs
        self._environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        self._handlers = []
        self._told = set()
        self.running = []
        self.reason = None

    def take(self, entities):
        for entity in entities:
            if isinstance(entity, self._api.RegisterEventHandler):
                self._handlers.append(entity.event_handler)
            elif isinstance(entity, self._api.EmitEvent):
                self.reason = entity.event.reason
            elif entity.condition is None:
                self._start(entity)

    def _start(self, node):
        words = [sys.executable, "-m", MODULES[node.executable], *node.arguments]
        if node.namespace:
            words += ["--ros-args", "-r", f"__ns:=/{node.namespace}"]
        log = (self._logs / f"{len(self.running)}.log").open("wb")
        with log, signals_blocked():  # what `end` sends waits for the handlers of the process
            process = subprocess.Popen(
                words, cwd=ROOT, env=self._environment, stdout=log, stderr=subprocess.STDOUT
            )
        self.running.append((node, process))

    def process(self, *words):
        """The one that was started with these among its words."""
        (found,) = [
            process
            for node, process in self.running
            if {*words} <= {node.executable, *node.arguments}
        ]
        return found

    def until(self, done):
        end = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < end, self.logs()
            for node, process in list(self.running):
                if process.poll() is not None and node not in self._told:
                    self._told.add(node)
                    event = self._api.ProcessExited(returncode=process.returncode)
                    for handler in self._handlers:
                        if handler.target_action is node and self.reason is None:
                            self.take(handler.handle(event, None))
            time.sleep(0.05)  # what is waited for stands in logs, too, and a log wakes nobody

    def end(self):
        for number in (signal.SIGINT, signal.SIGKILL):
            for _, process in self.running:
                if process.poll() is None:
                    process.send_signal(number)
            for _, process in self.running:
                try:
                    process.wait(60.0)
                except subprocess.TimeoutExpired:
                    continue

    def logs(self):
        return "\n".join(f"{file}: {file.read_text()}" for file in sorted(self._logs.iterdir()))


@pytest.fixture
def launched(api, domain, tmp_path):
    logs = tmp_path / "logs"
    logs.mkdir()
    flight = Launched(api, domain, logs)
    yield flight
    flight.end()


def test_lockstep_goes_on_without_a_uav_that_is_killed(api, launched, tmp_path):
    scenario = tmp_path / "short.yaml"
    scenario.write_text("name: short\nextends: paper_5\ntiming: {duration_s: 20}\n")
    context = api.LaunchContext()
    context.launch_configurations.update(
        scenario=str(scenario), lockstep="true", record=str(tmp_path / "bag")
    )
    file = runpy.run_path(str(BRINGUP / "launch" / "fleet.launch.py"))
    for entity in file["generate_launch_description"]().entities:
        launched.take(entity.visit(context) or [])
    launched.until(lambda: "coordinator: started" in launched.logs())
    launched.process("uav", "5").kill()
    launched.until(lambda: launched.reason is not None)
    launched.end()
    assert launched.reason == "the flight is over"
    assert launched.process("sim").returncode == 0
    assert launched.process("coordinator", "--manage").returncode == 0, launched.logs()
    assert launched.process("--lose", "uav5").returncode == 0
    assert launched.process("recorder").returncode == 0
    counts = {name: topic.messages for name, topic in read_bag(tmp_path / "bag").topics.items()}
    assert counts["/clock"] == counts["/uav1/setpoint/wrench"] == 2000
    assert counts["/uav5/setpoint/wrench"] < 2000
