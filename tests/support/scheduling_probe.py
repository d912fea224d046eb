"""A program that measures by how much this machine delays a process: on one core it works a little in every period.

    scheduling_probe.py CORE

Each line of input is answered with a line of JSON: the delays since the line before it. It is a process of its own: in
that of the tests it would measure what Python itself keeps it waiting.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time

PERIOD_S = 0.01
"""The control period of the shipped scenarios."""
WORK_S = 0.0005
"""Of the processor, in every period; a UAV's process takes more. A process that only wakes is let in early by Linux,
even where one that works gets far too little."""


def work_in_every_period(delays: list[float]) -> None:
    """Append the delay of the work of every period, also of those that have passed when the core comes back."""
    due = time.monotonic()
    while True:
        due += PERIOD_S
        time.sleep(max(due - time.monotonic(), 0.0))  # how late it returns is what is measured
        end = time.thread_time() + WORK_S
        while time.thread_time() < end:
            pass
        delays.append(time.monotonic() - due - WORK_S)


def main() -> None:
    delays: list[float] = []
    os.sched_setaffinity(0, {int(sys.argv[1])})
    threading.Thread(target=work_in_every_period, args=(delays,), daemon=True).start()
    for _ in sys.stdin:
        count = len(delays)
        print(json.dumps([round(delay, 6) for delay in delays[:count]]), flush=True)
        del delays[:count]


if __name__ == "__main__":
    main()
