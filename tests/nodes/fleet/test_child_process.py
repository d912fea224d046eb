"""Child processes: their logs, their summaries, their end."""

import os
import select
import signal
import time
from pathlib import Path

import pytest

from ptnsbc_nodes.fleet import child_process
from ptnsbc_nodes.fleet.child_process import ChildProcess, Crew, ProcessCommand, end
from ptnsbc_nodes.runtime import environment, launcher
from ptnsbc_nodes.runtime.node_process import report_finished


def test_what_lies_in_the_current_folder_is_not_imported(monkeypatch, tmp_path):
    folder = tmp_path / "users"
    (folder / "ptnsbc_nodes").mkdir(parents=True)
    for name in ("numpy.py", "yaml.py", "rclpy.py", "ptnsbc_nodes/__init__.py"):
        (folder / name).write_text("raise SystemExit('this is not it')")
    monkeypatch.chdir(folder)
    command = ProcessCommand("sim", "ptnsbc_nodes.sim.sim_main", ("--version",))
    child = ChildProcess(command, environment.for_children(5, 1, tmp_path), tmp_path)
    assert child.wait(60.0) == 0, child.tail()
    assert child.log_lines()[-1].startswith("ptnsbc ")


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Runs Python text as the module of a child."""
    monkeypatch.setattr(child_process, "_HARDER", {signal.SIGTERM: 0.3, signal.SIGKILL: 5.0})
    root = str(Path(environment.__file__).parents[2])
    settings = {**os.environ, "PYTHONPATH": os.pathsep.join([root, str(tmp_path)])}

    def start(text: str) -> ChildProcess:
        (tmp_path / "program.py").write_text(text)
        return ChildProcess(ProcessCommand("program", "program", ()), settings, tmp_path)

    return start


def test_an_error_of_the_user_is_shown_without_its_traceback(program):
    child = program(
        "import sys\nprint('Traceback', '  File x', 'program: a.py:3: law: no way', '  twice', sep='\\n')\n"
        "sys.exit(2)"
    )
    wait_for_exit(child)
    assert child.tail() == "    program: a.py:3: law: no way\n      twice"
    child = program("print('Traceback', 'program: words', sep='\\n'); raise SystemExit(1)")
    wait_for_exit(child)
    assert child.tail() == "    Traceback\n    program: words"


def wait_for_exit(child: ChildProcess) -> None:
    os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)  # its status stays for the child object


def test_a_report_may_be_longer_than_a_pipe(program):
    """The recorder of two hundred UAVs waited for the launcher, and the launcher for its end."""
    text = (
        "from ptnsbc_nodes.runtime.launcher import report_finished\nreport_finished(200_000 * 'x')"
    )
    child = program(text)
    assert child.wait(60.0) == 0, child.tail()
    assert child.reports.summary == 200_000 * "x"


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
    assert "signal SIGKILL" in child.exit_summary()


def test_an_exit_summary_has_the_last_lines_of_the_log(program):
    child = program("import sys\nprint('one', flush=True)\nsys.exit('two')")
    wait_for_exit(child)
    assert child.exit_code == 1
    assert f"program (pid {child.pid}) has ended: exit code 1" in child.exit_summary()
    assert child.exit_summary().endswith("    one\n    two")


def hour(seconds):
    return time.strftime("%H:%M:%S", time.localtime(seconds))


def test_messages_of_one_cause_are_one_line_with_their_count(program):
    """ROS writes level, time and node before each; the time tells what has long ended."""
    log = ["bridge1: landing at 3 m", "bridge1: landing at 2 m"]
    for second in range(5):
        log += [
            f"[ERROR] [179{second}.5] [uav1.bridge]: late for 0.{second} s",
            "[INFO] [179.1] [b]: all is well",
        ]
    child = program(f"print({log!r}, sep='\\n'); raise SystemExit(1)".replace("print(", "print(*"))
    wait_for_exit(child)
    assert child.tail().splitlines() == [
        "    bridge1: landing at 3 m",
        "    bridge1: landing at 2 m",
        f"    [ERROR] {hour(1794.5)} late for 0.4 s (5 times)",
        f"    [INFO] {hour(179.1)} all is well (5 times)",
    ]


def test_new_lines_come_once_and_whole(program):
    child = program("print('one\\ntwo\\nthr', end='')")
    wait_for_exit(child)
    assert child.new_lines() == ["one", "two"]
    assert child.new_lines() == []


REPORTS = """
import signal
from ptnsbc_nodes.runtime.launcher import report_finished, report_running
report_running()
report_finished("all is\\ndone")
signal.pause()
"""


@pytest.mark.slow
def test_a_process_reports_that_it_runs_and_that_it_has_finished_before_it_ends(program):
    child = program(REPORTS)
    until = time.monotonic() + 60.0
    while child.reports.summary is None:
        assert child.wait(0.01) is None and time.monotonic() < until, child.tail()
    assert child.reports.running
    assert child.reports.summary == "all is\ndone"
    end([child], patience_s=5.0)
    assert child.reports.summary == "all is\ndone"


def test_a_process_that_is_killed_at_work_has_no_summary(program):
    """What it writes into its log is no report."""
    child = program("import os; print('running\\nfinished 1', flush=True); os.abort()")
    wait_for_exit(child)
    assert (child.reports.running, child.reports.summary) == (False, None)


def test_a_process_that_replaces_another_has_a_log_of_its_own(tmp_path):
    crew = Crew(environment.for_children(5, 1, tmp_path), tmp_path)
    crew.start(ProcessCommand("bridge1", "no.such.module", ()))
    wait_for_exit(dead := crew.children[0])
    crew.start_again(dead)
    wait_for_exit(crew.children[0])
    crew.start_again(crew.children[0])
    wait_for_exit(crew.children[0])
    assert {path.name for path in tmp_path.glob("*.log")} == {
        "bridge1.log",
        "bridge1-2.log",
        "bridge1-3.log",
    }
    assert "no.such" in dead.tail()


def test_a_report_without_a_launcher_goes_nowhere(monkeypatch):
    monkeypatch.delenv(launcher.REPORT, raising=False)
    report_finished("all is done")
