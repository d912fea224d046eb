"""`make test` and `make slow`: the tests in two halves, in parallel, then, one by one, what flies in real time.

    tests/run.py quick|slow JOBS [WORD...]

Both halves always run, and each ends in one line of the summary. With words for pytest, as in
`make test ARGS="-k frames"`, only the first half runs, on all tests, whether quick or slow.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]


class Half(NamedTuple):
    """What came of one run of pytest."""

    line: str
    code: int


def run_half(name: str, *words: str) -> Half:
    """Run pytest once."""
    print(f"=== {name}: pytest {' '.join(words)}", flush=True)
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "counts.json"
        command = (
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-rs",
            "--durations=20",
            "--durations-min=2",
            "--counts",
            str(file),
            *words,
        )
        code = subprocess.run(command, cwd=ROOT, check=False).returncode
        try:
            counts = json.loads(file.read_text())
        except OSError:
            told = f"ended with exit code {code} before its tests did"
        else:
            told = ", ".join(f"{number} {kind}" for kind, number in counts.items())
    return Half(f"{name}: {told} in {time.monotonic() - start:.0f} s", code)


def main() -> int:
    """The exit code: 0 where no test of either half failed."""
    kind, jobs, *words = sys.argv[1:]
    # A file belongs to one worker: what its tests share is made once, and no other worker loads its laws.
    by_file = ["--dist", "loadfile", "--no-loadscope-reorder"]
    # The next worker tries a test that ended one again, twice at most.
    by_file += ["--max-worker-restart", "2"]
    workers = () if jobs == "1" else ("-n", jobs, *by_file)
    if words:
        halves = [run_half("in parallel", *workers, "-m", "not alone", *words)]
        halves.append(Half("in real time: left out, other words were given", 0))
    else:
        which = {"quick": "not slow", "slow": "slow"}[kind]
        place = {"quick": "tests/support", "slow": "tests/nodes"}[kind]
        halves = [run_half("in parallel", *workers, "-m", f"{which} and not alone")]
        halves.append(run_half("in real time", "-m", f"{which} and alone", place))
    print("=== summary", *(half.line for half in halves), sep="\n", flush=True)
    return max(half.code for half in halves)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
