"""Digests of recorded flights, to show that a change of the code has changed no bit of a flight.

`python -m bench.digests before.txt`, change the code, `python -m bench.digests after.txt`, and compare both with
`diff`. Every scenario is flown headless for 20 s with every plant, formation task and avoidance rule, and `paper_5`
for 8 s by a fleet in lock-step. The file has one line for each headless flight and one for each topic of the fleet.

`python -m bench.digests --again 50 --beside 10` flies `paper_5` so often in lock-step, beside so many busy loops: all
bags have the same bytes, however late a message is.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path

from mcap.reader import make_reader

from bench.session import print_progress
from ptnsbc_core.tasks.table import TASKS

SCENARIOS = ("paper_5", "paper_5_free", "paper_20", "experiment_4", "experiment_4_calm")
PLANTS = ("quadrotor", "rigid_body_6dof")
RULES = ("set_based", "switched", "off")
_DIGITS = 16


def topic_digests(bag: Path) -> dict[str, str]:
    """SHA-256 of (log time, data) of all messages of each topic, in the order of the file."""
    found: dict[str, hashlib._Hash] = {}
    for file in sorted(bag.glob("*.mcap")):
        with file.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                digest = found.setdefault(channel.topic, hashlib.sha256())
                digest.update(message.log_time.to_bytes(8, "little") + message.data)
    return {topic: found[topic].hexdigest()[:_DIGITS] for topic in sorted(found)}


def headless(case: tuple[str, str, str, str], root: Path, folder: Path, seconds: float) -> str:
    """The line of one headless flight."""
    scenario, plant, task, rule = case
    bag = folder / "-".join(case)
    chosen = ("--plant", plant, "--task", task, "--avoidance", rule)
    code = ptnsbc(root, "simulate", scenario, *chosen, "--duration", f"{seconds:g}", bag=bag)
    topics = topic_digests(bag)
    shutil.rmtree(bag)  # all of them would need gigabytes
    digest = hashlib.sha256(repr(sorted(topics.items())).encode()).hexdigest()[:_DIGITS]
    return f"{' '.join(case)} exit={code} topics={len(topics)} {digest}"


def lockstep(root: Path, folder: Path, seconds: float) -> Iterator[str]:
    """The lines of the fleet in lock-step."""
    bag = folder / "lockstep"
    flags = ("--lockstep", "--duration", f"{seconds:g}")
    code = ptnsbc(root, "fleet", "paper_5", *flags, bag=bag)
    for topic, digest in topic_digests(bag).items():
        yield f"lockstep {topic} {digest}"
    yield f"lockstep exit={code}"


def ptnsbc(root: Path, *words: str, bag: Path) -> int:
    """Exit code of a command of the checkout `root`: 0, or 1 for a deadline that was not met."""
    done = subprocess.run(
        [sys.executable, "-m", "ptnsbc_tools.cli", *words, "--bag", str(bag)],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
    )
    if done.returncode not in (0, 1):
        raise SystemExit(f"ptnsbc {' '.join(words)}: exit code {done.returncode}\n{done.stderr}")
    return done.returncode


def again(root: Path, folder: Path, seconds: float, times: int, beside: int) -> int:
    """Fly the fleet in lock-step beside busy loops; 1 when two bags differ."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(beside)]
    found, bag = Counter[str](), folder / "bag"  # its name is in the file
    try:
        for number in range(1, times + 1):
            ptnsbc(root, "fleet", "paper_5", "--lockstep", "--duration", f"{seconds:g}", bag=bag)
            files = b"".join(file.read_bytes() for file in sorted(bag.glob("*.mcap")))
            found[hashlib.sha256(files).hexdigest()[:_DIGITS]] += 1
            shutil.rmtree(bag)
            print_progress(f"digests: {number} of {times} flights: {dict(found)}")
    finally:
        for loop in busy:
            loop.kill()
    print(
        f"{times} flights beside {beside} busy loops: {len(found)} digest{'s'[len(found) == 1 :]}"
    )
    return int(len(found) > 1)


def _lines(options: argparse.Namespace, folder: Path) -> Iterator[str]:
    cases = list(product(options.scenarios, PLANTS, TASKS, RULES))
    fly = partial(headless, root=options.root, folder=folder, seconds=options.seconds)
    with ThreadPoolExecutor(options.jobs) as pool:
        for number, line in enumerate(pool.map(fly, cases), 1):
            print_progress(f"digests: {number} of {len(cases)}: {line}")
            yield line
    print_progress("digests: the fleet in lock-step")
    yield from lockstep(options.root, folder, options.fleet_seconds)


def _write(path: Path, lines: Iterable[str]) -> None:
    with path.open("w", encoding="utf-8") as file:
        for line in lines:
            print(line, file=file, flush=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Write the digests of every flight."""
    parser = argparse.ArgumentParser(prog="bench.digests", description=__doc__)
    parser.add_argument("output", type=Path, nargs="?", metavar="OUT", help="text file to write")
    parser.add_argument(
        "--again", type=int, default=0, metavar="N", help="lock-step flights to compare"
    )
    parser.add_argument("--beside", type=int, default=0, metavar="K", help="busy loops beside them")
    parser.add_argument("--jobs", type=int, default=3, help="headless flights at a time")
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS, metavar="SCENARIO")
    parser.add_argument("--seconds", type=float, default=20.0, help="of a headless flight")
    parser.add_argument("--fleet-seconds", type=float, default=8.0, help="of the lock-step flight")
    root = Path(__file__).resolve().parents[1]
    parser.add_argument(
        "--root", type=Path, default=root, help="checkout to fly, this one if not given"
    )
    options = parser.parse_args(argv)
    options.root = options.root.resolve()
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        if options.again:
            seconds, count = options.fleet_seconds, options.again
            return again(options.root, Path(name), seconds, count, options.beside)
        if options.output is None:
            parser.error("expected OUT, or --again N")
        _write(options.output, _lines(options, Path(name)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
