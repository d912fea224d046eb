"""SIGINT, SIGTERM and SIGHUP: every process has its handlers before anything else, and ends in order."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from ptnsbc_nodes.runtime.signals import (
    StopRequest,
    exit_on_signal,
    restore_handlers,
    signals_blocked,
)

ROOT = Path(__file__).resolve().parents[3]
PATIENCE_S = 240  # "ptnsbc fleet" may compile the laws before its last moment


def test_a_signal_wakes_who_waits_for_it():
    with StopRequest() as stop:
        assert not stop.wait(0.0)
        began = time.monotonic()
        sender = threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGTERM))
        sender.start()
        assert stop.wait(30.0)
        sender.join()
        assert time.monotonic() - began < 15.0
        assert stop.wait(30.0)


def test_a_stop_request_gives_the_handlers_back():
    before = signal.getsignal(signal.SIGINT)
    with StopRequest() as stop:
        assert not stop.came
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.came
    assert signal.getsignal(signal.SIGINT) is before


HANGS_UP = """
import pathlib, sys
from ptnsbc_nodes.runtime.signals import StopRequest

with StopRequest() as stop:
    print("ready", flush=True)
    stop.wait(60.0)
    print("a summary for nobody", flush=True)
    pathlib.Path(sys.argv[1]).write_text(f"{stop.count} stop")
"""


def test_a_terminal_that_is_closed_is_one_order_to_stop_and_its_words_end_nothing(tmp_path):
    ours, theirs = os.openpty()
    # `setsid -c` makes the terminal the one that hangs up on it.
    command = ["setsid", "-c", sys.executable, "-c", HANGS_UP, str(tmp_path / "said")]
    process = subprocess.Popen(command, cwd=ROOT, stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    assert b"ready" in os.read(ours, 100)
    os.close(ours)
    assert process.wait(60.0) == 0
    assert (tmp_path / "said").read_text() == "1 stop"


def test_who_ignores_that_a_terminal_is_closed_goes_on_so():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopRequest() as stop:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not stop.came
    finally:
        signal.signal(signal.SIGHUP, before)


def test_handlers_of_a_process_can_be_given_back():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    exit_on_signal(3)
    exit_on_signal(4)
    restore_handlers()
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


# An object of this module is destroyed when the interpreter has given the signals back to the system.
ENDS = """
import os, signal, sys
from ptnsbc_nodes.runtime.signals import exit_on_signal, keep_exit_code

class Last:
    def __init__(self):
        self.kill, self.write = os.kill, os.write
        self.pid, self.number = os.getpid(), int(sys.argv[1])

    def __del__(self):
        self.write(2, b"signal sent")
        self.kill(self.pid, self.number)

exit_on_signal(4)
keep_exit_code(3)
last = Last()
sys.exit(3)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda n: n.name)
def test_a_signal_while_the_interpreter_ends_changes_no_exit_code(number):
    process = [sys.executable, "-c", ENDS, str(int(number))]
    done = subprocess.run(process, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (3, "signal sent")


# Sends the process a signal at a moment of its start, once: at the import of a module, or before all of them.
HOOK = """
import os, signal, sys
at, number = os.environ["SIGNAL_AT"], int(os.environ["SIGNAL"])

def send():
    global at
    at = None
    os.write(2, b"signal sent\\n")
    os.kill(os.getpid(), number)

def on_event(event, arguments):
    if event == "import" and arguments[0] == at:
        send()

sys.addaudithook(on_event)
if at == "start":
    send()
"""

SCENARIO = ("--scenario", "paper_5")
PROCESSES = {
    "uav": ("ptnsbc_nodes.uav.uav_main", *SCENARIO, "--uav", "1"),
    "sim": ("ptnsbc_nodes.sim.sim_main", *SCENARIO),
    "bridge": ("ptnsbc_nodes.bridge.bridge_main", *SCENARIO, "--uav", "1"),
    "recorder": ("ptnsbc_nodes.recording.recorder_main", "--bag", "bag", "--uavs", "1"),
    "coordinator": ("ptnsbc_nodes.fleet.coordinator_main", *SCENARIO),
    "ptnsbc fleet": ("ptnsbc_tools", "fleet", "paper_5"),
}
INTERRUPTED = {"ptnsbc fleet": 130}  # the others end with 0
LAST = {
    "uav": "ptnsbc_nodes.uav.uav_node",
    "sim": "ptnsbc_nodes.sim.sim_node",
    "bridge": "ptnsbc_nodes.bridge.process",
    "recorder": "ptnsbc_nodes.recording.fleet_recorder",
    "coordinator": "ptnsbc_nodes.fleet.fleet_node",
    "ptnsbc fleet": "ptnsbc_nodes.fleet.supervisor",
}
MOMENTS = ["start", "ptnsbc_nodes.runtime.signals", "numpy", "rclpy", "last"]


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize("name", PROCESSES)
def test_a_signal_at_any_moment_of_the_start_ends_a_process_in_order(name, domain, tmp_path):
    """The signals in turn, which have one handler."""
    pytest.importorskip("rclpy")
    (tmp_path / "hook").mkdir()
    (tmp_path / "hook" / "sitecustomize.py").write_text(HOOK)
    running = {}
    for row, moment in enumerate(MOMENTS):
        number = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)[row % 3]
        (folder := tmp_path / moment).mkdir()
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(tmp_path / "hook"), str(ROOT)]),
            "ROS_DOMAIN_ID": str(domain),
            "SIGNAL_AT": LAST[name] if moment == "last" else moment,
            "SIGNAL": str(int(number)),
        }
        with signals_blocked():  # as the launcher starts a process
            running[moment] = subprocess.Popen(
                [sys.executable, "-m", *PROCESSES[name]],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env=environment,
                cwd=folder,
            )
    ends = {}
    for moment, process in running.items():
        try:
            _, err = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
        assert "signal sent" in err, (moment, err)
        assert "Traceback" not in err and "KeyboardInterrupt" not in err, (moment, err)
        ends[moment] = process.returncode
    assert ends == dict.fromkeys(MOMENTS, INTERRUPTED.get(name, 0))
