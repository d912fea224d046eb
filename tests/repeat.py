"""`make repeat N=8 PROCESSES=30`: the tests again and again, on a free machine and on a busy one in turn.

    tests/repeat.py N PROCESSES JOBS [WORD...]

`make test` runs N times. Then its part that starts processes runs, without the flights in real time, until it has run
PROCESSES times; the N runs of everything count. Every second run has as many busy loops beside it as there are cores.
Words go to pytest, as in `make repeat ARGS="-k signals"`. Prints the time and the summary of each run, and how many
tests were not judged; nothing is run again because it failed.
"""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
STARTS_PROCESSES = (
    "nodes", "io/bag", "autopilot", "paper", "tools/commands", "tools/live", "tools/replay", "bench", "test_launch.py",
)  # fmt: skip
QUICK = "not slow and not alone"
NOT_JUDGED = re.compile(r"(\d+) not judged")
BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"
"""A busy loop that ends with the program that started it."""


class Run(NamedTuple):
    """What came of one run of the tests."""

    passed: bool
    not_judged: int  # tests in real time that failed while others had the machine


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Each in a session of its own, as another user's program is."""
    loops = [
        subprocess.Popen([sys.executable, "-S", "-c", BUSY], start_new_session=True)
        for _ in range(count)
    ]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def run(title: str, loops: int, log: Path, *words: str) -> Run:
    """Run the tests once, with all output in a file."""
    start, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    with busy_loops(loops), log.open("w") as stream:
        command = (sys.executable, str(HERE / "run.py"), *words)
        code = subprocess.run(command, stdout=stream, stderr=stream, check=False).returncode
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    summary = log.read_text(errors="replace").rpartition("=== summary\n")[2].strip().splitlines()
    print(
        f"{title}, {loops} busy loops: {'ok' if code == 0 else f'FAILED, see {log}'}, "
        f"{time.monotonic() - start:.0f} s, {cpu:.0f} s of processors",
        *(f"  {line}" for line in summary[-2:]),
        sep="\n",
        flush=True,
    )
    not_judged = sum(int(count) for line in summary for count in NOT_JUDGED.findall(line))
    return Run(code == 0, not_judged)


def main() -> int:
    times, part_times, jobs = (int(word) for word in sys.argv[1:4])
    words = ("quick", str(jobs), *sys.argv[4:])
    logs = HERE.parent / "out" / "repeat"
    logs.mkdir(parents=True, exist_ok=True)
    cores = len(os.sched_getaffinity(0))
    paths = [str(HERE / place) for place in STARTS_PROCESSES]
    for path in paths:
        os.stat(path)  # now, and not after an hour
    runs = []
    for k in range(times):
        file = logs / f"all{k + 1}.log"
        runs.append(run(f"all, {k + 1} of {times}", k % 2 * cores, file, *words))
    for k in range(times, part_times):
        title, file = f"processes, {k + 1} of {part_times}", logs / f"processes{k + 1}.log"
        runs.append(run(title, k % 2 * cores, file, *words, "-m", QUICK, *paths))
    passed, not_judged = sum(one.passed for one in runs), sum(one.not_judged for one in runs)
    print(f"{passed} of {len(runs)} runs without a failure, {not_judged} tests not judged")
    return 0 if passed == len(runs) else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
