"""Fleets as users fly them: commands in their own processes, stand-ins on real UDP, one fleet at a time."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from itertools import combinations, pairwise
from pathlib import Path

import yaml
from domain_ports import first_port

from bench.stand_ins import BASE, SCENARIO
from ptnsbc_autopilot.fault_lines import send_fault
from ptnsbc_autopilot.vehicle import AutopilotError

ROOT = Path(__file__).resolve().parents[2]
COMMAND = "ptnsbc_tools.cli"
PATIENCE_S = 600
_INTERRUPTED = (0, 130)

# The vehicles sink as fast as they climb, because these flights do not test the landing.
_LANDING = {"px4": "MPC_LAND_SPEED=1.5", "ardupilot": "LAND_SPD_MS=1.5"}


def write_scenario(path, domain, *, duration_s, fleet):
    """Some UAVs of `experiment_4` on ports of their own: by id, 1 among them and not 2, the kind and the setpoints.

    Its four UAVs with bridges and stand-ins are all that two cores can do in real time, at 50 Hz too.
    """
    first = first_port(domain)
    followers = [number for number in fleet if number != 1]
    left_out = {number: None for number in (2, 3, 4) if number not in fleet}
    base = yaml.safe_load(Path(BASE).read_text(encoding="utf-8"))
    tree = yaml.safe_load(SCENARIO.format(base=BASE, duration_s=duration_s))
    tree |= {
        "sensor": {"rate_hz": 10, "positioning": {"latency_s": 0.04}},
        "communication": {
            "tree": left_out,
            "leader_links": followers,
            "estimator_edges": list(map(list, pairwise(followers))),
        },
        "formation": {"offsets_m": dict(left_out)},
        "uavs": [uav for uav in base["uavs"] if uav["id"] in fleet],
    }
    tree["timing"]["control_hz"] = 50
    tree["mavlink"]["vehicles"] = {
        number: {
            "autopilot": kind,
            "setpoint": setpoint,
            "connect": f"udpin:127.0.0.1:{first + number}",
        }
        for number, (kind, setpoint) in fleet.items()
    }
    path.write_text(yaml.safe_dump(tree))
    return path


class Program:
    """A command in its own process, and its output."""

    def __init__(self, module, *arguments, domain):
        self.lines, self.out = [], ""
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", module, *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            cwd=ROOT,
        )
        # A fleet that hangs fails its test and does not hang the test.
        self._watchdog = threading.Timer(PATIENCE_S, self.process.kill)
        self._watchdog.daemon = True
        self._watchdog.start()
        self._new_line = threading.Condition()
        self._readers = [
            threading.Thread(target=read, daemon=True) for read in (self._read, self._collect)
        ]
        for reader in self._readers:
            reader.start()

    def _read(self):
        for line in self.process.stderr:
            with self._new_line:
                self.lines.append(line.rstrip())
                self._new_line.notify_all()
        self.process.wait()  # who waits for a line asks whether the program has ended
        with self._new_line:
            self._new_line.notify_all()

    def _collect(self):
        self.out = self.process.stdout.read()

    def printed(self, *texts):
        """Whether each of these texts is in one line of stderr."""
        return all(any(text in line for line in self.lines) for text in texts)

    def wait_for(self, *texts, patience_s=150):
        """Wait until stderr contains all of these texts."""

        def over():
            return self.printed(*texts) or self.process.poll() is not None

        with self._new_line:
            self._new_line.wait_for(over, patience_s)
        assert self.printed(*texts), self.lines

    def finish(self, number=None):
        """The exit code; a signal is sent first if one is given."""
        if number is not None and self.process.poll() is None:
            self.process.send_signal(number)
        code = self.process.wait(PATIENCE_S)
        self._watchdog.cancel()
        for reader in self._readers:
            reader.join()
        return code

    def json_output(self):
        """The JSON on stdout."""
        return json.loads(self.out)


@contextmanager
def stand_ins(path, domain, *options, count, kinds=("px4",)):
    """The `count` flight controllers of the scenario at `path`, with RTK receivers as in the paper's experiment."""
    landing = [word for kind in kinds for word in ("--param", _LANDING[kind])]
    program = Program(
        COMMAND, "autopilot", "--scenario", path, "--gcs", "", "--boot-time", "0",
        "--gnss", "rtk", *landing, *options, domain=domain,
    )  # fmt: skip
    try:
        # Stand-ins and fleet compile at their first start, one after the other.
        program.wait_for(f"system {count} at", patience_s=PATIENCE_S)
        yield program
    finally:
        assert program.finish(signal.SIGINT) in _INTERRUPTED, program.lines


@contextmanager
def flying(module, *arguments, domain):
    """A fleet that ends with the test in any case."""
    program = Program(module, *arguments, domain=domain)
    try:
        yield program
    finally:
        program.finish(signal.SIGINT)


def mode_of(control, system, other_than, patience_s=60.0):
    """The mode of a stand-in once it has changed; its control port answers once per tick."""
    end = time.monotonic() + patience_s
    while True:
        mode = json.loads(send_fault(control, f"{system} state"))[0]["mode"]
        if mode != other_than or time.monotonic() > end:
            return mode


@contextmanager
def nearest_pair(control):
    """The distances [m] between the nearest two stand-ins by their own truth, in a list that grows."""
    distances_m, over = [], threading.Event()

    def look():
        while not over.wait(0.1):
            with suppress(AutopilotError):  # a busy machine answers late
                states = json.loads(send_fault(control, "all state"))
                places = [state["position_enu_m"] for state in states]
                distances_m.append(min(math.dist(*pair) for pair in combinations(places, 2)))

    watcher = threading.Thread(target=look)
    watcher.start()
    try:
        yield distances_m
    finally:
        over.set()
        watcher.join()


def pid_of(module, number, logs):
    """The process id of one UAV of this fleet."""
    for entry in Path("/proc").iterdir():
        try:
            command = (entry / "cmdline").read_bytes().decode().replace("\0", " ")
        except OSError:
            continue
        if all(word in command for word in (module, f"--uav {number}", str(logs))):
            return int(entry.name)
    raise AssertionError(f"no {module} of UAV {number}")
