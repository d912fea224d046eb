"""kill -9 of a process that writes a bag as the recorder does, at random moments: what is left after a repair."""

from __future__ import annotations

import itertools
import random
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from ptnsbc_io.bag import BagWriter, declare
from ptnsbc_io.wire import HeaderTemplate
from ptnsbc_tools.library.bags import repair

_HZ = 1000  # as often as a fleet speaks
_EARLIEST, _LATEST = 600, 2500  # ticks


class Kill(NamedTuple):
    """One recording that was killed."""

    loss_s: float  # from the newest message in the repaired bag to the last one that was told before the kill
    messages: int  # deserialised by rosbags from the repaired bag
    missing: int  # holes in a topic's sequence: nothing before the last second may be lost


def killed_recordings(count: int, seed: int, folder: Path) -> Iterator[Kill]:
    """Kill `count` recordings side by side, each when it has told of a tick of its own."""
    moments = random.Random(seed)
    last = {folder / f"killed{n}": moments.randint(_EARLIEST, _LATEST) for n in range(count)}
    command = [sys.executable, __file__]
    running = {
        bag: subprocess.Popen([*command, str(bag)], stdout=subprocess.PIPE, text=True)
        for bag in last
    }
    try:
        for bag, process in running.items():
            if not any(int(line) == last[bag] for line in process.stdout or ()):
                raise RuntimeError(f"{bag}: ended before tick {last[bag]}")
            process.kill()
    finally:
        for process in running.values():
            process.kill()
            process.communicate()
    for bag, tick in last.items():
        yield _judged(bag, _time_ns(tick))


def _time_ns(tick: int) -> int:
    return tick * 10**9 // _HZ


def _judged(bag: Path, killed_ns: int) -> Kill:
    """Repair, then let an independent reader look at everything."""
    from rosbags.highlevel import AnyReader

    repair(bag, discard=True)
    stamps: dict[str, list[int]] = {}
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            stamp = reader.deserialize(raw, connection.msgtype).stamp
            stamps.setdefault(connection.topic, []).append(stamp.sec * 10**9 + stamp.nanosec)
        last_ns = reader.end_time
    missing = sum(_holes(of_topic) for of_topic in stamps.values())
    return Kill((killed_ns - last_ns) * 1e-9, sum(map(len, stamps.values())), missing)


def _holes(stamps: list[int]) -> int:
    """Messages missing between the first and the last, of a sender that counts its stamps."""
    if len(stamps) < 2:
        return 0
    step = min(b - a for a, b in pairwise(stamps) if b > a)
    return round((stamps[-1] - stamps[0]) / step) + 1 - len(set(stamps))


def _write(bag: Path) -> None:
    """Write as the recorder does, by a clock of its own, and tell every tick, until killed."""
    template = HeaderTemplate("count")
    topics = [declare(f"/topic{k}", "std_msgs/msg/Header") for k in range(5)]
    with BagWriter(bag, topics) as writer:
        for tick in itertools.count():
            for topic in topics:
                writer.write(topic.name, _time_ns(tick), template.encode(1000 * tick))
            writer.flush_if_due(tick / _HZ)
            print(tick, flush=True)


if __name__ == "__main__":
    _write(Path(sys.argv[1]))
