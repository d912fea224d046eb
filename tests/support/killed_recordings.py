"""kill -9 of a process that writes a bag as the recorder does, at random moments: what is left after a repair."""

from __future__ import annotations

import random
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from ptnsbc_io.bag import BagWriter, TopicInfo
from ptnsbc_io.bag.repair import repair
from ptnsbc_io.wire import HeaderTemplate

_HZ = 1000.0
_EARLIEST_S, _LATEST_S = 0.6, 2.5
_BEFORE_FIRST_S = 60.0
_LOOK_S = 0.01


class Kill(NamedTuple):
    """One recording that was killed."""

    loss_s: float  # from the newest message in the repaired bag to the kill
    messages: int  # deserialised by rosbags from the repaired bag
    missing: int  # holes in a topic's sequence: nothing before the last second may be lost


def killed_recordings(count: int, seed: int, folder: Path) -> Iterator[Kill]:
    """Kill `count` recordings side by side, each at a moment of its own."""
    moments = random.Random(seed)
    bags = {folder / f"killed{n}": moments.uniform(_EARLIEST_S, _LATEST_S) for n in range(count)}
    running = {
        bag: subprocess.Popen([sys.executable, __file__, str(bag)], stderr=subprocess.DEVNULL)
        for bag in bags
    }
    killed_ns = {}
    try:
        first_s = {bag: _first_message_s(bag, process) for bag, process in running.items()}
        for bag, after_s in sorted(bags.items(), key=lambda item: first_s[item[0]] + item[1]):
            # Nothing is waited for: the moment is the experiment.
            time.sleep(max(first_s[bag] + after_s - time.monotonic(), 0.0))
            killed_ns[bag] = time.time_ns()
            running[bag].kill()
            running[bag].wait()
    finally:
        for process in running.values():
            process.kill()
            process.wait()
    for bag in bags:
        yield _judged(bag, killed_ns[bag])


def _first_message_s(bag: Path, process: subprocess.Popen[bytes]) -> float:
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
    """Write as the recorder does in real time, until killed."""
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


if __name__ == "__main__":
    _write(Path(sys.argv[1]))
