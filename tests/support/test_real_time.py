"""A failure is hidden only where others had the machine."""

import os
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from real_time import Delays, Usage, taken

HERE = Path(__file__).parent
PROMPT, LATE, STOPPED = Delays(0.001, 0.02), Delays(0.011, 0.02), Delays(0.001, 0.6)


def seconds(*, idle, ours, others, cores=2):
    """Usage of ten seconds, by shares."""
    assert idle + ours + others == pytest.approx(1.0)
    return Usage(10.0 * cores, 10.0 * cores * idle, 10.0 * cores * ours)


@pytest.mark.parametrize(
    ("delays", "usage", "judged"),
    [
        (PROMPT, seconds(idle=0.9, ours=0.08, others=0.02), True),
        (LATE, seconds(idle=0.0, ours=0.97, others=0.03), True),  # it starved itself
        (STOPPED, seconds(idle=0.97, ours=0.01, others=0.02), True),
        (PROMPT, seconds(idle=0.0, ours=0.5, others=0.5), True),  # others yielded in time
        (LATE, seconds(idle=0.0, ours=0.5, others=0.5), False),
        (STOPPED, seconds(idle=0.1, ours=0.4, others=0.5), False),
    ],
)
def test_late_and_by_others(delays, usage, judged):
    assert taken(delays, usage) is not judged


def test_a_difference_in_rounding_is_no_time_of_others():
    assert Usage(1.0, 0.6, 0.5).others == 0.0
    assert Usage(0.0, 0.0, 0.0).others == 0.0


FAILING = """
import subprocess, sys, time, pytest

BUSY = [sys.executable, "-S", "-c", "while True: pass"]

@pytest.mark.alone
def test_fails():
    time.sleep(1.0)
    assert 1 == 2, "as it must"

@pytest.mark.alone
def test_starves_itself():
    loops = [subprocess.Popen(BUSY) for _ in range(LOOPS)]
    try:
        time.sleep(1.0)
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
"""On one core; few of them would let a process in that wakes."""


@contextmanager
def on_one_core():
    """So it takes no more busy loops on a machine of many cores."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def run(folder):
    (folder / "test_flight.py").write_text(FAILING.replace("LOOPS", str(LOOPS)))
    options = ("-q", "-p", "real_time", "-p", "no:cacheprovider", "-c", "pytest.ini")
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = alone\n")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(HERE)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


@pytest.mark.alone
def test_on_an_idle_machine_every_failure_is_one(tmp_path):
    with on_one_core():
        code, out = run(tmp_path)
    assert code == 1
    assert out.splitlines()[-1].startswith("3 failed, 1 passed in"), out
    assert "scheduling delay p99" in out


@pytest.mark.alone
def test_beside_busy_loops_of_others_it_is_not_judged(tmp_path):
    busy = [sys.executable, "-S", "-c", "while True: pass"]
    with on_one_core(), ExitStack() as stack:
        for _ in range(LOOPS):
            loop = subprocess.Popen(busy)
            stack.callback(loop.wait)
            stack.callback(loop.kill)
        time.sleep(0.5)
        code, out = run(tmp_path)
    assert code == 1  # of the test that is not in real time
    assert "1 failed, 1 passed, 2 not judged in" in out.splitlines()[-1], out
    assert "not judged: the machine was taken away: scheduling delay p99" in out
    assert "as it must" in out
