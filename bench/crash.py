"""kill -9 of a recording at random moments: does every bag open after repair, and how much is lost?

`python -m bench.crash [--kills 50] [--seed 1] [--recorder]`. Without --recorder a small process writes as the
recorder does; with it a real recorder is fed over DDS by one source of 2500 messages/s.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from ptnsbc_io.bag import BagWriter, TopicInfo
from ptnsbc_io.bag.repair import repair

_HZ = 1000.0
_EARLIEST_S, _LATEST_S = 0.6, 2.5
_BEFORE_FIRST_S = 60.0
_SIDE_BY_SIDE = 5
_LOOK_S = 0.01
_FOREVER_S = 3600.0


class Kill(NamedTuple):
    """One recording that was killed."""

    after_s: float  # time from its first message
    loss_s: float  # from the newest message in the repaired bag to the kill
    messages: int  # deserialised by rosbags from the repaired bag
    missing: int  # holes in a topic's sequence: nothing before the last second may be lost


def kills(count: int, seed: int, folder: Path, *, recorder: bool) -> Iterator[Kill]:
    """Kill `count` recordings, each at a moment of its own."""
    moments = random.Random(seed)
    at_once = 1 if recorder else _SIDE_BY_SIDE
    with _source(folder) if recorder else nullcontext() as settings:
        for first in range(0, count, at_once):
            numbers = range(first, min(first + at_once, count))
            bags = {folder / f"killed{n}": moments.uniform(_EARLIEST_S, _LATEST_S) for n in numbers}
            yield from _killed(bags, settings)


def _killed(bags: dict[Path, float], settings: Mapping[str, str] | None) -> Iterator[Kill]:
    running = {bag: _start(bag, settings) for bag in bags}
    ended = {}
    try:
        began = {bag: _began(bag, process) for bag, process in running.items()}
        for bag, after_s in sorted(bags.items(), key=lambda item: began[item[0]] + item[1]):
            # Nothing is waited for: the moment is the experiment.
            time.sleep(max(began[bag] + after_s - time.monotonic(), 0.0))
            ended[bag] = time.time_ns()
            running[bag].kill()
            running[bag].wait()
    finally:
        for process in running.values():
            process.kill()
            process.wait()
    for bag, after_s in bags.items():
        yield _judged(bag, after_s, ended[bag])


def _start(bag: Path, settings: Mapping[str, str] | None) -> subprocess.Popen[bytes]:
    words = ["-m", "bench.crash", "--write", str(bag)]
    if settings is not None:
        words = ["-m", "ptnsbc_nodes.recording.main", "--bag", str(bag), "--uavs", *"12345"]
    quiet = subprocess.DEVNULL
    return subprocess.Popen([sys.executable, *words], stdout=quiet, stderr=quiet, env=settings)


def _began(bag: Path, process: subprocess.Popen[bytes]) -> float:
    """The time at which the first messages were on disk."""
    file = bag.with_name(bag.name + ".part") / f"{bag.name}_0.mcap"
    end, empty = time.monotonic() + _BEFORE_FIRST_S, 0
    while time.monotonic() < end and process.poll() is None:
        size = file.stat().st_size if file.exists() else 0
        empty = empty or size
        if size > empty:
            return time.monotonic()
        with suppress(subprocess.TimeoutExpired):  # a file that grows wakes nobody
            process.wait(_LOOK_S)
    raise RuntimeError(f"{bag}: no message in {_BEFORE_FIRST_S:g} s")


def _judged(bag: Path, after_s: float, ended_ns: int) -> Kill:
    """Repair, then let an independent reader look at everything."""
    from rosbags.highlevel import AnyReader

    repair(bag, discard=True)
    stamps: dict[str, list[int]] = {}
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            header = getattr(message, "header", message)
            if hasattr(header, "stamp"):  # a list of transforms has none
                own = header.stamp.sec * 10**9 + header.stamp.nanosec
                stamps.setdefault(connection.topic, []).append(own)
        last_ns = reader.end_time
    missing = sum(_holes(own) for own in stamps.values())
    total = sum(len(own) for own in stamps.values())
    return Kill(after_s, (ended_ns - last_ns) * 1e-9, total, missing)


def _holes(stamps: list[int]) -> int:
    """Messages missing between the first and the last, of a sender that counts its stamps."""
    if len(stamps) < 2:
        return 0
    step = min(b - a for a, b in pairwise(stamps) if b > a)
    return round((stamps[-1] - stamps[0]) / step) + 1 - len(set(stamps))


@contextmanager
def _source(folder: Path) -> Iterator[Mapping[str, str]]:
    """A process that publishes for as long as recorders come and go; gives the environment of both."""
    from bench.scenarios import paper
    from bench.session import own_domain
    from ptnsbc_nodes.runtime import environment

    scenario, go = folder / "scenario.yaml", folder / "go"
    scenario.write_text(paper(1.0).text, encoding="utf-8")
    go.touch()
    with own_domain() as domain:
        settings = environment.for_children(domain, 2, folder)
        words = ["-m", "bench.recorder", "--scenario", str(scenario), "--go", str(go)]
        words += ["--seconds", str(_FOREVER_S), "--hz", "100"]
        quiet = subprocess.DEVNULL
        process = subprocess.Popen([sys.executable, *words], env=settings, stdout=quiet)
        try:
            yield settings
        finally:
            process.kill()
            process.wait()


def _write(bag: Path) -> None:
    """Write as the recorder does in real time, until killed."""
    from ptnsbc_io.wire import HeaderTemplate

    template = HeaderTemplate("count")
    topics = [TopicInfo(f"/topic{k}", "std_msgs/msg/Header") for k in range(5)]
    with BagWriter(bag, topics) as writer:
        due, count = time.monotonic(), 0
        while True:
            for topic in topics:
                writer.write(topic.name, time.time_ns(), template.encode(1000 * count))
            count += 1
            writer.flush_if_due(time.monotonic())
            due += 1.0 / _HZ
            # As often as a fleet speaks.
            time.sleep(max(due - time.monotonic(), 0.0))


def main(argv: Sequence[str] | None = None) -> int:
    """Print one line per kill and the worst; 1 when a bag lost a second or has a hole."""
    parser = argparse.ArgumentParser(prog="bench.crash", description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recorder", action="store_true", help="real recorders, over DDS")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.write is not None:
        _write(options.write)
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        found = []
        for kill in kills(options.kills, options.seed, Path(name), recorder=options.recorder):
            found.append(kill)
            print(f"bench: {len(found)} of {options.kills}: {kill}", file=sys.stderr, flush=True)
    worst = max(kill.loss_s for kill in found)
    holes = sum(kill.missing for kill in found)
    if options.json:
        print(json.dumps({"kills": [kill._asdict() for kill in found], "worst_loss_s": worst}))
    else:
        print(
            f"{len(found)} bags opened; worst loss {worst:.3f} s; {holes} messages missing inside"
        )
    # Best effort over DDS may lose messages long before the kill; a file may not.
    return int(worst >= 1.0 or (holes > 0 and not options.recorder))


if __name__ == "__main__":
    raise SystemExit(main())
