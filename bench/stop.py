"""`ptnsbc stop` at random moments of flights, does every vehicle obey, and how soon?

`python -m bench.stop [--times 20] [--orders kill,land] [--seed 1]`. Each run is a whole fleet on four stand-ins over
UDP, without the dry runs before it. A terminal stands ready (`ptnsbc stop --ready`). At a random moment of the climb,
the hover or the formation the key is pressed. The time of a vehicle runs from there until the stand-in itself has its
motors off, or lands.
"""

from __future__ import annotations

import argparse
import json
import random
import statistics
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
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
from ptnsbc_autopilot.fault_lines import send_fault
from ptnsbc_autopilot.vehicle import AutopilotError

_MOMENT_S = 20.0  # the key is pressed within this time after all have begun to climb
_OBEYED_S = 20.0
_FLIGHT_S = 120.0


class Stopped(NamedTuple):
    """One order in one flight."""

    order: str
    seconds: dict[int, float]  # by system id, from the key until the vehicle obeyed
    exit_code: int
    lines: tuple[str, ...]  # what the command printed

    @property
    def all_obeyed(self) -> bool:
        """True if every vehicle obeyed, and the command said so."""
        return len(self.seconds) == len(VEHICLES) and self.exit_code == 0


def run_once(order: str, moment_s: float) -> Stopped:
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
                return _press(terminal, order, control)


def _press(terminal: Running, order: str, control: int) -> Stopped:
    assert terminal.process.stdin is not None
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
            run = run_once(order, chance.uniform(0.0, _MOMENT_S))
            runs.append(run)
            times = ", ".join(f"{i}: {run.seconds.get(i, float('nan')):.2f}" for i in VEHICLES)
            print(f"{turn + 1} {order}: exit {run.exit_code}, {times} s", flush=True)
            if not run.all_obeyed:
                print("\n".join(run.lines), flush=True)
    for order, runs in found.items():
        print(_summary(order, runs))
    if not all(run.all_obeyed for runs in found.values() for run in runs):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
