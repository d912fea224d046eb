"""`make repeat N=8 PROCESSES=30`: the tests again and again, on a free machine and on a busy one in turn.

    tests/repeat.py N PROCESSES JOBS

`tests/run.py` runs N times, then the part that starts processes runs PROCESSES times. Every second run has as many busy
loops beside it as there are cores. Prints the time and the summary of each run; nothing is run again because it failed.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

HERE = Path(__file__).resolve().parent
STARTS_PROCESSES = (
    "nodes", "io/bag", "sim/autopilot", "tools/commands", "tools/replay", "tools/reproduce", "bench", "test_launch.py",
)  # fmt: skip
BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"
"""A busy loop that ends with the program that started it."""


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


def run(title: str, loops: int, log: Path, *words: str) -> bool:
    """Run the tests once, with all output in a file; whether none failed."""
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
    return code == 0


def main() -> int:
    times, part_times, jobs = (int(word) for word in sys.argv[1:])
    logs = HERE.parent / "out" / "repeat"
    logs.mkdir(parents=True, exist_ok=True)
    cores = len(os.sched_getaffinity(0))
    paths = [str(HERE / place) for place in STARTS_PROCESSES]
    passed = []
    for k in range(times):
        file = logs / f"all{k + 1}.log"
        passed.append(run(f"all, {k + 1} of {times}", k % 2 * cores, file, str(jobs)))
    for k in range(part_times):
        title, file = f"processes, {k + 1} of {part_times}", logs / f"processes{k + 1}.log"
        passed.append(run(title, k % 2 * cores, file, str(jobs), *paths))
    print(f"{sum(passed)} of {len(passed)} runs without a failure")
    return 0 if all(passed) else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
