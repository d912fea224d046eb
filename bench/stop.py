"""`ptnsbc stop` at random moments of flights, two bridges starved of CPU: does every vehicle obey, and how soon?

`python -m bench.stop [--times 20] [--orders kill,land] [--seed 1]`. Each run is a whole fleet on four stand-ins over
UDP, without the dry runs before it. A terminal stands ready (`ptnsbc stop --ready`). At a random moment of the climb,
the hover or the formation two bridges get the lowest priority on one core, beside two busy loops; then the key is
pressed. The time of a vehicle runs from there until the stand-in itself has its motors off, or lands.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from bench.stand_ins import (
    PATIENCE_S,
    VEHICLES,
    Running,
    program,
    stand_ins,
    wait_for,
    write_scenario,
)
from ptnsbc_autopilot.faults import send_fault
from ptnsbc_autopilot.vehicle import AutopilotError

_MOMENT_S = 20.0  # the key is pressed within this time after all have begun to climb
_OBEYED_S = 20.0
_STARVED = 2
_FLIGHT_S = 120.0


class Stopped(NamedTuple):
    """One order in one flight."""

    order: str
    seconds: dict[
        int, float
    ]  # by system id: from the key until the vehicle obeyed; those that did not are missing
    exit_code: int
    lines: tuple[str, ...]  # what the command printed

    @property
    def all_obeyed(self) -> bool:
        """True if every vehicle obeyed, and the command said so."""
        return len(self.seconds) == len(VEHICLES) and self.exit_code == 0


def run_once(order: str, moment_s: float, starved: Sequence[int]) -> Stopped:
    """One flight and one order."""
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        folder = Path(name)
        scenario, control = write_scenario(folder, _FLIGHT_S)
        domain = random.randint(81, 100)
        fleet = ("fleet", scenario, "--backend", "mavlink", "--allow-arming", "--no-check")
        stop = ("stop", "--ready", *(["--kill"] if order == "kill" else []))
        with (
            stand_ins(folder, domain, scenario, control),
            program(folder, "fleet", domain, "ptnsbc_tools.cli", *fleet) as flight,
        ):
            wait_for(flight, [f"bridge{i}: taking off" for i in VEHICLES])
            with program(folder, "stop", domain, "ptnsbc_tools.cli", *stop) as terminal:
                wait_for(terminal, ["bridge4"])
                # A drawn moment of climb, hover or formation: no event marks it.
                time.sleep(moment_s)
                with _starved([_bridge_pid(flight.process.pid, i) for i in starved]):
                    return _press(terminal, order, control)


def _press(terminal: Running, order: str, control: int) -> Stopped:
    assert terminal.process.stdin is not None
    time.sleep(0.5)  # the starving has begun
    pressed = time.monotonic()
    terminal.process.stdin.write(b"\n")
    terminal.process.stdin.flush()
    found: dict[int, float] = {}
    while len(found) < len(VEHICLES) and time.monotonic() - pressed < _OBEYED_S:
        with suppress(AutopilotError):
            for state in json.loads(send_fault(control, "all state")):
                obeyed = not state["armed"] or (order == "land" and state["mode"] == "LAND")
                if obeyed:
                    found.setdefault(state["system"], time.monotonic() - pressed)
        time.sleep(0.01)
    code = terminal.process.wait(PATIENCE_S)
    return Stopped(order, found, code, tuple(terminal.log.read_text().splitlines()))


@contextmanager
def _starved(pids: Sequence[int]) -> Iterator[None]:
    """Inside the `with` these processes have what two busy loops on one core leave to the lowest priority."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        for loop in busy:
            os.sched_setaffinity(loop.pid, {0})
        for pid in pids:
            for thread in os.listdir(f"/proc/{pid}/task"):
                os.sched_setscheduler(int(thread), os.SCHED_IDLE, os.sched_param(0))
                os.sched_setaffinity(int(thread), {0})
        yield
    finally:
        for loop in busy:
            loop.kill()
            loop.wait()


def _bridge_pid(launcher: int, uav: int) -> int:
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError, IndexError):
            command = (entry / "cmdline").read_bytes().decode().replace("\0", " ")
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == launcher and "bridge.main" in command and f"--uav {uav} " in command:
                return int(entry.name)
    raise SystemExit(f"no bridge of UAV {uav}")


def _summary(order: str, runs: Sequence[Stopped]) -> str:
    firsts = sorted(min(run.seconds.values()) for run in runs if run.seconds)
    lasts = sorted(max(run.seconds.values()) for run in runs if run.seconds)
    obeyed = sum(run.all_obeyed for run in runs)
    vehicles = sum(len(run.seconds) for run in runs)
    return (
        f"{order}: {obeyed} of {len(runs)} orders reached all vehicles with exit code 0; "
        f"{vehicles} of {len(VEHICLES) * len(runs)} vehicles; "
        f"first vehicle median {statistics.median(firsts):.2f} s; last vehicle median "
        f"{statistics.median(lasts):.2f} s, 90 % {lasts[int(0.9 * (len(lasts) - 1))]:.2f} s, "
        f"largest {lasts[-1]:.2f} s"
    )


def main() -> None:
    """Fly, stop, and print the distribution of the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=20, help="flights per order")
    parser.add_argument("--orders", default="kill,land")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    chance = random.Random(arguments.seed)
    found: dict[str, list[Stopped]] = {order: [] for order in arguments.orders.split(",")}
    for turn in range(arguments.times):
        for order, runs in found.items():
            starved = chance.sample(VEHICLES, _STARVED)
            run = run_once(order, chance.uniform(0.0, _MOMENT_S), starved)
            runs.append(run)
            times = ", ".join(f"{i}: {run.seconds.get(i, float('nan')):.2f}" for i in VEHICLES)
            print(
                f"{turn + 1} {order}: starved {starved}, exit {run.exit_code}, {times} s",
                flush=True,
            )
            if not run.all_obeyed:
                print("\n".join(run.lines), flush=True)
    for order, runs in found.items():
        print(_summary(order, runs))
    if not all(run.all_obeyed for runs in found.values() for run in runs):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
