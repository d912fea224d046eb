"""A failure is hidden only where others had the machine."""

import os
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from real_time import Cores, Usage, taken, usage

HERE = Path(__file__).parent
PROMPT, LATE, STOPPED = Cores(0.001, 0.02, 8e6), Cores(0.011, 0.02, 8e6), Cores(0.001, 0.6, 8e6)


def ten_seconds(*, idle, ours, others, cores=2):
    """Usage of ten seconds, by shares."""
    assert idle + ours + others == pytest.approx(1.0)
    return Usage(10.0 * cores, 10.0 * cores * idle, 10.0 * cores * ours)


@pytest.mark.parametrize(
    ("cores", "used", "judged"),
    [
        (PROMPT, ten_seconds(idle=0.9, ours=0.08, others=0.02), True),
        (LATE, ten_seconds(idle=0.0, ours=0.97, others=0.03), True),  # it starved itself
        (STOPPED, ten_seconds(idle=0.97, ours=0.01, others=0.02), True),
        (PROMPT, ten_seconds(idle=0.0, ours=0.5, others=0.5), True),  # others yielded in time
        (LATE, ten_seconds(idle=0.0, ours=0.5, others=0.5), False),
        (STOPPED, ten_seconds(idle=0.1, ours=0.4, others=0.5), False),
    ],
)
def test_late_and_by_others(cores, used, judged):
    assert taken(cores, used) is not judged


def test_a_difference_in_rounding_is_no_time_of_others():
    assert Usage(1.0, 0.6, 0.5).others == 0.0
    assert Usage(0.0, 0.0, 0.0).others == 0.0


FAILING = """
import subprocess, sys, time, pytest
from pathlib import Path

BUSY = [sys.executable, "-S", "-c", "while True: pass"]

@pytest.mark.alone
def test_fails():
    Path("begun").touch()
    while not Path("go").exists():
        time.sleep(0.01)  # between two looks: a file gives no notice
    time.sleep(1.0)  # a second in which the machine is measured
    Path("over").touch()
    assert 1 == 2, "as it must"

@pytest.mark.alone
def test_starves_itself():
    loops = [subprocess.Popen(BUSY) for _ in range(LOOPS)]
    try:
        time.sleep(1.0)  # the same
        assert 1 == 2, "as it must"
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()

@pytest.mark.alone
def test_passes():
    pass

def test_of_another_kind_fails():
    assert 1 == 2, "as it must"
"""
LOOPS = 24
"""On one core."""


@contextmanager
def on_one_core():
    """So it takes no more busy loops on a machine of many cores."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def start(folder, *words, nice=0):
    """Pytest with the flights, in a folder of its own, by `nice` below our priority."""
    (folder / "test_flight.py").write_text(FAILING.replace("LOOPS", str(LOOPS)))
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = alone\n")
    options = ("-q", "-p", "real_time", "-p", "no:cacheprovider", "-c", "pytest.ini", *words)
    return subprocess.Popen(
        ["nice", "-n", str(nice), sys.executable, "-m", "pytest", *options],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(HERE)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.mark.alone
def test_on_an_idle_machine_every_failure_is_one(tmp_path):
    (tmp_path / "go").touch()
    with on_one_core():
        before = usage()
        with start(tmp_path) as flights:
            out, _ = flights.communicate()
        others = usage().minus(before).others
    if "not judged" in out and others > 0.02:
        pytest.skip(f"the machine is not idle: other programs had {others:.0%} of this core")
    assert flights.returncode == 1
    assert out.splitlines()[-1].startswith("3 failed, 1 passed in"), out
    assert "scheduling delay p99" in out


@pytest.mark.alone
def test_beside_busy_loops_of_others_it_is_not_judged(tmp_path):
    # Of equal priority, a scheduler may let the probe in within its period: below it, none does.
    with on_one_core(), start(tmp_path, "-k", "not starves", nice=10) as flights:

        def wait(name):
            while not (tmp_path / name).exists():
                assert flights.poll() is None
                time.sleep(0.01)  # between two looks: a file gives no notice

        wait("begun")
        with ExitStack() as loops:
            for _ in range(LOOPS):
                loop = subprocess.Popen([sys.executable, "-S", "-c", "while True: pass"])
                loops.callback(loop.wait)
                loops.callback(loop.kill)
            (tmp_path / "go").touch()
            wait("over")
        out, _ = flights.communicate()
    assert flights.returncode == 1  # of the test that is not in real time
    assert "1 failed, 1 passed, 1 deselected, 1 not judged in" in out.splitlines()[-1], out
    assert "not judged: the machine was taken away: scheduling delay p99" in out
    assert "as it must" in out
