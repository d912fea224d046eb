"""`python -m bench.fuzz`: mutated bags, scenarios, files, messages and packets; whatever they are, no traceback.

    python -m bench.fuzz [--seconds S] [--bags N] [--scenarios N] [--files N] [--wire N] [--mavlink N] [--cli N]
                         [--seed K]

Each input goes through the library, `--cli` bags and scenarios also through the command line. An input that raises
anything but an error in words, or takes more than 2 s of a processor or 300 MB of memory, is kept in `bench/corpus`,
whose inputs every later run tries first. With `--seconds` it goes on for so long, all kinds in turn.

A command that takes longer than 2 s is measured again, three times in turn with a process that imports numba. The
median of the ratios counts, as seconds of a processor on which that import takes 0.35 s: other guests of a host slow
both processes down.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import resource
import statistics
import subprocess
import sys
import tempfile
import time
import traceback
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import count, cycle, islice
from pathlib import Path
from typing import NamedTuple

from bench.fuzz_inputs import FUZZERS, ROOT, Fuzzer

CORPUS = Path(__file__).with_name("corpus")
KINDS = tuple(FUZZERS)
LONGEST_S = 2.0
LARGEST_MB = 300.0
_PTNSBC, _REFERENCE = (sys.executable, "-m", "ptnsbc_tools"), (sys.executable, "-c", "import numba")
_REFERENCE_S = 0.35  # of a processor that no other guest of the host slows down
_REPEATED = 3
_TELL_S = 10.0  # between two lines of progress


class Cost(NamedTuple):
    """The time and memory of one input."""

    seconds: float  # of a processor
    megabytes: float  # largest memory of the process


class Result(NamedTuple):
    """The outcomes of many inputs."""

    inputs: int
    slowest: Cost
    largest: Cost
    failures: list[str]


def measured(work: Callable[[bytes], None], data: bytes) -> Cost:
    """Run `work` and tell what it took; the largest memory is that of this process meanwhile."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # forget the largest so far
    began = time.process_time()
    work(data)
    seconds = time.process_time() - began
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return Cost(seconds, int(status.partition("VmHWM:")[2].split()[0]) / 1024)


def tried(fuzzer: Fuzzer, data: bytes) -> tuple[Cost, str]:
    """Time and memory that one input took, and the limit that it broke; most break none."""
    try:
        cost = measured(fuzzer.run, data)
    except Exception:
        return Cost(0.0, 0.0), traceback.format_exc(limit=-3)
    return cost, _too_much(cost)


def _too_much(cost: Cost) -> str:
    if cost.seconds > LONGEST_S:
        return f"{cost.seconds:.1f} s"
    return f"{cost.megabytes:.0f} MB" if cost.megabytes > LARGEST_MB else ""


def inputs(kind: str, fuzzer: Fuzzer, seed: int) -> Iterator[bytes]:
    """First the corpus, then mutations without end; the same for the same seed."""
    for path in sorted((CORPUS / kind).glob("*")):
        yield path.read_bytes()
    for k in count():
        yield fuzzer.make(random.Random(f"{seed} {kind} {k}"))


def compile_laws(kinds: Sequence[str]) -> None:
    """Compile the laws of these kinds in a process of its own: the memory of the compiler is not that of an input."""
    for kind in kinds:
        process = multiprocessing.get_context("spawn").Process(target=fuzzed, args=(kind, 0, 0))
        process.start()
        process.join()


def fuzzed(kind: str, number: int, seed: int, seconds: float | None = None) -> Result:
    """So many inputs of one kind, or as many as fit into a time."""
    slowest = largest = Cost(0.0, 0.0)
    failures: list[str] = []
    done = 0
    with tempfile.TemporaryDirectory(prefix="ptnsbc-fuzz-") as folder:
        fuzzer = FUZZERS[kind](Path(folder))
        for data in fuzzer.sound:
            fuzzer.run(data)  # the laws are loaded once: no input is to blame for that
        told_s = time.monotonic()
        end = told_s + (seconds or float("inf"))
        for data in inputs(kind, fuzzer, seed):
            if time.monotonic() > end or (seconds is None and done >= number):
                break
            cost, wrong = tried(fuzzer, data)
            done += 1
            slowest = max(slowest, cost)
            largest = max(largest, cost, key=lambda one: one.megabytes)
            if wrong:
                failures.append(f"{kept(kind, data)}: {wrong}")
            if time.monotonic() > told_s + _TELL_S:
                told_s = time.monotonic()
                print(
                    f"{kind}: {done} inputs, {len(failures)} failures", file=sys.stderr, flush=True
                )
    return Result(done, slowest, largest, failures)


def kept(kind: str, data: bytes) -> Path:
    """The file of the corpus that holds an input from now on."""
    path = CORPUS / kind / f"{zlib.crc32(data):08x}"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def through_commands(number: int, seed: int) -> Result:
    """So many bags and so many scenarios through the commands in turn, each in a process of its own."""
    slowest = largest = Cost(0.0, 0.0)
    failures: list[str] = []
    done = 0
    with tempfile.TemporaryDirectory(prefix="ptnsbc-fuzz-") as folder:
        for kind, commands in _COMMANDS.items():
            fuzzer = FUZZERS[kind](Path(folder))
            path = Path(folder) / ("flight.mcap" if kind == "bags" else "flight.yaml")
            path.write_bytes(fuzzer.sound[0])
            for words in commands:
                _process([*_PTNSBC, *words, str(path)])  # what it needs is compiled
            for words, data in islice(zip(cycle(commands), inputs(kind, fuzzer, seed)), number):
                path.write_bytes(data)
                cost, wrong = _command(*words, str(path))
                done += 1
                slowest = max(slowest, cost)
                largest = max(largest, cost, key=lambda one: one.megabytes)
                if wrong:
                    failures.append(f"{kept(kind, data)}: ptnsbc {' '.join(words)}: {wrong}")
    return Result(done, slowest, largest, failures)


_BY_COMMANDS = "through the commands"
_COMMANDS = {
    "bags": (("verify", "--json"), ("bag", "info", "--check")),
    "scenarios": (("check", "--no-fly"),),  # a dry run takes seconds, whatever the file is
}


def _command(*words: str) -> tuple[Cost, str]:
    call = [*_PTNSBC, *words]
    cost, code, err = _process(call)
    if code not in (0, 1, 2) or "Traceback" in err:
        return cost, f"exit code {code}: {err[-2000:]}"
    if not err.isprintable() and any(not line.isprintable() for line in err.splitlines()):
        return cost, "characters that act on a terminal"
    if cost.seconds > LONGEST_S:
        seconds = undisturbed_s(call)
        print(f"{cost.seconds:.2f} s, measured again: {seconds:.2f} s", file=sys.stderr, flush=True)
        cost = cost._replace(seconds=seconds)
    return cost, _too_much(cost)


def undisturbed_s(call: Sequence[str]) -> float:
    """Seconds of a processor that a process takes where `_REFERENCE` takes `_REFERENCE_S`."""
    ratios = [_process(call)[0].seconds / _process(_REFERENCE)[0].seconds for _ in range(_REPEATED)]
    return statistics.median(ratios) * _REFERENCE_S


def _process(call: Sequence[str]) -> tuple[Cost, int, str]:
    """The cost of a process, its exit code and what it says on stderr."""
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=said, cwd=ROOT)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        err = said.read().decode(errors="replace")
    cost = Cost(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
    return cost, process.returncode, err


def _shown(name: str, result: Result) -> str:
    return (
        f"{name}: {result.inputs} inputs, {len(result.failures)} failures, slowest {result.slowest.seconds:.2f} s "
        f"of a processor, largest {result.largest.megabytes:.0f} MB"
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 1 when an input failed."""
    parser = argparse.ArgumentParser(prog="bench.fuzz", description=__doc__.partition(":")[0])
    parser.add_argument("--seconds", type=float, help="as many inputs of each kind as fit, in turn")
    for kind in KINDS:
        parser.add_argument(f"--{kind}", type=int, default=None, help="how many")
    parser.add_argument("--cli", type=int, default=0, help="how many of each through the commands")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(argv)
    # An input that asks for too much must not take the machine with it.
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
    numbers = {kind: getattr(options, kind) for kind in KINDS}
    chosen = [kind for kind in KINDS if numbers[kind] or not (any(numbers.values()) or options.cli)]
    failures: list[str] = []
    compile_laws(chosen)
    for kind in chosen:
        share = None if options.seconds is None else options.seconds / len(chosen)
        result = fuzzed(kind, numbers[kind] or 1000, options.seed, share)
        failures += result.failures
        print(_shown(kind, result), flush=True)
    if options.cli:
        result = through_commands(options.cli, options.seed)
        failures += result.failures
        print(_shown(_BY_COMMANDS, result), flush=True)
    for line in failures:
        print(line, file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
