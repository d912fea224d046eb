"""Bags of growing size through every command that reads bags: peak memory and time of each.

`python -m bench.huge [--gigabytes 0.25 0.5 1]`. A bag is a real flight, over and over, uncompressed.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from bench.session import print_progress
from ptnsbc_io.bag import BagWriter, TopicInfo, read_bag
from ptnsbc_io.wire.cdr import write_stamp

_FLIGHT_S = 20.0
_UNSTAMPED = ("/formation/markers", "/tf", "/formation/epoch")
_COMMANDS = {
    "read every message": None,
    "bag info --check": ("bag", "info", "{bag}", "--check"),
    "verify": ("verify", "{bag}"),
    "replay --rerun": ("replay", "{bag}", "--rerun"),
    "report": ("report", "{bag}", "-o", "{report}"),
    "bag repair": ("bag", "repair", "{bag}", "-o", "{repaired}"),
}


def write(bag: Path, size: int) -> None:
    """One flight after the other, each message with the stamp of its round."""
    from bench.scenarios import paper
    from ptnsbc_sim.swarm import fly
    from ptnsbc_tools.reading.headless import write_flight

    scenario = paper(_FLIGHT_S)
    short = read_bag(write_flight(fly(scenario), bag.with_name("short"), overwrite=True))
    infos = [TopicInfo(topic.name, topic.type) for topic in short.topics.values()]
    attachments = {name: short.attachment(name) for name in short.attachments}
    length_ns = short.end_ns + scenario.dt_ns
    messages = list(short.messages())
    file, rounds = bag.with_name(f"{bag.name}.part") / f"{bag.name}_0.mcap", 0
    with BagWriter(bag, infos, attachments=attachments, compression="none") as writer:
        while file.stat().st_size < size:
            for topic, stamp_ns, data in messages:
                if rounds and topic in _UNSTAMPED:
                    continue
                shifted = bytearray(data)
                write_stamp(shifted, stamp_ns + rounds * length_ns)
                writer.write(topic, stamp_ns + rounds * length_ns, bytes(shifted))
            rounds += 1


def main(argv: Sequence[str] | None = None) -> int:
    """One line per command and size."""
    parser = argparse.ArgumentParser(prog="bench.huge", description=__doc__)
    parser.add_argument("--gigabytes", type=float, nargs="+", default=[0.25, 0.5, 1.0])
    parser.add_argument("--read", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.read is not None:
        count = sum(1 for _ in read_bag(options.read).messages())
        print(f"{count} messages")
        return 0
    for gigabytes in options.gigabytes:
        with tempfile.TemporaryDirectory(prefix="bench-") as name:
            _one_size(Path(name) / "huge", gigabytes)
    return 0


def _one_size(bag: Path, gigabytes: float) -> None:
    print_progress("writing the bag")
    write(bag, round(gigabytes * 1e9))
    size = sum(file.stat().st_size for file in bag.iterdir())
    for what, words in _COMMANDS.items():
        print_progress(what)
        _measure(f"{size / 1e9:.2f} GB, {what}", _words(words, bag))


def _words(words: tuple[str, ...] | None, bag: Path) -> list[str]:
    if words is None:
        return ["-m", "bench.huge", "--read", str(bag)]
    beside = {"repaired": bag.with_name("repaired"), "report": bag.with_name("report")}
    named = (word.format(bag=bag, **beside) for word in words)
    return ["-m", "ptnsbc_tools.cli", *named]


def _measure(what: str, words: Sequence[str]) -> None:
    """In a process of its own, whose peak the system tells when it has ended."""
    began = time.monotonic()
    script = [sys.executable, "-c", _CHILD, *words]
    done = subprocess.run(script, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    peak_kb = int(done.stdout.splitlines()[-1])
    seconds = time.monotonic() - began
    print(
        f"{what:28s} {peak_kb / 1024:7.0f} MB peak, {seconds:6.1f} s, exit code {done.returncode}",
        flush=True,
    )


# Its own child, so that the peak is that of the command alone.
_CHILD = """
import resource, subprocess, sys
code = subprocess.run([sys.executable, *sys.argv[1:]], stdout=subprocess.DEVNULL).returncode
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(code)
"""

if __name__ == "__main__":
    raise SystemExit(main())
