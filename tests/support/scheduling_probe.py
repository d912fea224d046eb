"""A program that measures one core: by how much it delays a process, and how fast it is.

    scheduling_probe.py CORE

Each line of input is answered with a line of JSON: the delays since the line before it, in seconds, and the rounds of
work that the core did in a second of its time. It is a process of its own: in that of the tests it would measure what
Python itself keeps it waiting.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time

PERIOD_S = 0.01
"""The control period of the shipped scenarios."""
ROUNDS = 4000
"""Of work in every period, half a millisecond of a fast core; a UAV's process takes more. A process that only wakes is
let in early by Linux, even where one that works gets far too little."""


def work_in_every_period(periods: list[tuple[float, float]]) -> None:
    """Append the delay and the time of the work of every period, also of those that passed while the core was away."""
    due = time.monotonic()
    while True:
        due += PERIOD_S
        time.sleep(max(due - time.monotonic(), 0.0))  # how late it returns is what is measured
        begun, total = time.thread_time(), 0
        for number in range(ROUNDS):
            total += number * number % 7
        work_s = time.thread_time() - begun
        periods.append((time.monotonic() - due - work_s, work_s))


def main() -> None:
    periods: list[tuple[float, float]] = []
    os.sched_setaffinity(0, {int(sys.argv[1])})
    threading.Thread(target=work_in_every_period, args=(periods,), daemon=True).start()
    for _ in sys.stdin:
        count = len(periods)
        delays = [round(delay_s, 6) for delay_s, _ in periods[:count]]
        work_s = sum(work_s for _, work_s in periods[:count])
        rounds_a_s = ROUNDS * count / work_s if work_s else 0.0
        print(json.dumps({"delays_s": delays, "rounds_a_s": rounds_a_s}), flush=True)
        del periods[:count]


if __name__ == "__main__":
    main()
