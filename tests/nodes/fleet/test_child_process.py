"""The parts under the launcher: domains, the environment of children, ending processes."""

import os
import resource
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from ptnsbc_nodes.fleet import child_process
from ptnsbc_nodes.fleet.child_process import ChildProcess, ProcessCommand, end
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.ros_domain import DomainError, reserved_domain
from ptnsbc_nodes.runtime.signals import StopRequest


@pytest.fixture
def no_domain(monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)


def test_two_fleets_get_two_domains(no_domain):
    with reserved_domain() as first, reserved_domain() as second:
        assert first != second
        assert {first, second} <= set(range(1, 102))


def test_the_users_domain_wins(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    with reserved_domain() as domain:
        assert domain == 77


def test_a_users_domain_that_is_no_number_is_refused(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "x")
    with pytest.raises(DomainError, match="ROS_DOMAIN_ID='x'"), reserved_domain():
        pass


def test_what_lies_in_the_current_folder_is_not_imported(own_discovery, monkeypatch, tmp_path):
    folder = tmp_path / "users"
    (folder / "ptnsbc_nodes").mkdir(parents=True)
    for name in ("numpy.py", "yaml.py", "rclpy.py", "ptnsbc_nodes/__init__.py"):
        (folder / name).write_text("raise SystemExit('this is not it')")
    monkeypatch.chdir(folder)
    command = ProcessCommand("sim", "ptnsbc_nodes.sim.main", ("--version",))
    child = ChildProcess(command, environment.for_children(5, 1, tmp_path), tmp_path)
    assert child.wait(60.0) == 0, child.tail()
    assert child.last_line().startswith("ptnsbc ")


@pytest.fixture
def own_discovery(monkeypatch):
    for name in (
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        "FASTDDS_DEFAULT_PROFILES_FILE",
        "ROS_DISCOVERY_SERVER",
        "RMW_IMPLEMENTATION",
    ):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def test_children_probe_as_many_peers_as_there_are(own_discovery, tmp_path):
    settings = environment.for_children(5, 43, tmp_path)
    assert settings["ROS_DOMAIN_ID"] == "5"
    profile = Path(settings["FASTRTPS_DEFAULT_PROFILES_FILE"]).read_text()
    assert "<maxInitialPeersRange>55</maxInitialPeersRange>" in profile


def test_a_users_discovery_is_left_alone(own_discovery, monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    settings = environment.for_children(5, 43, tmp_path)
    assert settings["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    assert "FASTRTPS_DEFAULT_PROFILES_FILE" not in settings


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Runs Python text as the module of a child."""
    monkeypatch.setattr(child_process, "_HARDER", {signal.SIGTERM: 0.3, signal.SIGKILL: 5.0})
    settings = {**os.environ, "PYTHONPATH": str(tmp_path)}

    def start(text: str) -> ChildProcess:
        (tmp_path / "program.py").write_text(text)
        return ChildProcess(ProcessCommand("program", "program", ()), settings, tmp_path)

    return start


def wait_for_exit(child: ChildProcess) -> None:
    os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)  # its status stays for the child object


DEAF = """
import select
import signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
signal.signal(signal.SIGTERM, signal.SIG_IGN)
open("{pipe}", "w").close()
while True:
    signal.pause()
"""


def test_a_deaf_process_is_ended_all_the_same(program, tmp_path):
    os.mkfifo(tmp_path / "deaf")
    opened = os.open(tmp_path / "deaf", os.O_RDONLY | os.O_NONBLOCK)
    child = program(DEAF.format(pipe=tmp_path / "deaf"))
    assert select.select([opened], [], [], 20)[0], child.tail()
    os.close(opened)
    end([child], patience_s=0.3)
    assert child.exit_code == -signal.SIGKILL
    assert "signal SIGKILL" in child.obituary()


def test_an_obituary_has_the_last_words(program):
    child = program("import sys\nprint('one')\nsys.exit('two')")
    wait_for_exit(child)
    assert child.exit_code == 1
    assert f"program (pid {child.pid}) has ended: exit code 1" in child.obituary()
    assert child.obituary().endswith("    one\n    two")


def test_new_lines_come_once_and_whole(program):
    child = program("print('one\\ntwo\\nthr', end='')")
    wait_for_exit(child)
    assert child.new_lines() == ["one", "two"]
    assert child.new_lines() == []


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


def test_a_child_whose_launcher_has_gone_ends(monkeypatch):
    monkeypatch.setenv(environment.PARENT, "1" if os.getppid() != 1 else "2")
    code = os.system(
        f"{sys.executable} -c 'from ptnsbc_nodes.runtime import environment as e; e.prepare()'"
    )
    assert os.waitstatus_to_exitcode(code) == 1


HURRY = """
import os, threading
from ptnsbc_nodes.runtime import environment
waiting = threading.Event()
threading.Thread(target=waiting.wait).start()  # a node has threads before it knows whom it flies
for flies in (False, True):
    assert environment.prefer_punctuality(flies=flies)
    for thread in os.listdir("/proc/self/task"):
        print(os.sched_getscheduler(int(thread)), os.sched_getparam(int(thread)).sched_priority)
waiting.set()
"""


def _may_hurry():
    soft, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    return os.geteuid() == 0 or soft > 1


@pytest.mark.skipif(not _may_hurry(), reason="no right to real-time scheduling here")
def test_who_flies_runs_before_who_records_and_both_before_the_rest():
    root = Path(environment.__file__).parents[2]
    told = subprocess.run(
        [sys.executable, "-c", HURRY], capture_output=True, text=True, check=True, cwd=root
    )
    assert told.stdout.split() == [str(os.SCHED_RR), "1"] * 2 + [str(os.SCHED_RR), "2"] * 2


def test_without_the_right_to_hurry_everything_goes_on(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert environment.prefer_punctuality(flies=True) is False
