"""`ptnsbc stop --ready` past bridges that die: is every vehicle reached, and how soon?

`python -m bench.stop [--times 200] [--seed 1]`. Two stand-ins hover, each with the process of a bridge and no fleet
around it. In each trial a terminal stands ready, and one or both bridges are killed, stopped, or killed and started
again, at a random moment before it opens or after. Then the key is pressed: land or kill in turn. The time of a vehicle
runs from there until the stand-in itself lands, or has its motors off. Where a bridge was stopped nothing tells the
command that the vehicle obeys, and its exit code is 1.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench.stand_ins import PATIENCE_S, program, stand_ins, wait_for, write_scenario
from ptnsbc_autopilot.fault_lines import send_fault
from ptnsbc_nodes.emergency import forget_dead, list_fleet, records, release, runtime_folder
from ptnsbc_nodes.runtime.environment import free_domain

_UAVS, _STRIKES, _PYTHON = (1, 2), ("kill", "stop", "restart"), (sys.executable, "-m")
_WITHIN_S, _OBEYED_S, _PATIENCE_S = 5.0, 8.0, 4


class Bridges:
    """The processes of the bridges of stand-ins that hover."""

    def __init__(self, folder: Path, domain: int, scenario: Path, control: int) -> None:
        self.folder, self.domain, self._scenario, self._control = folder, domain, scenario, control
        self._processes: dict[int, subprocess.Popen[bytes]] = {}

    def begin(self) -> None:
        """All vehicles hover, and all bridges know it."""
        folder = runtime_folder(self.domain)
        release(folder)
        for uav in _UAVS:
            self.strike(uav, "restart")
        forget_dead(folder)
        list_fleet(folder, [f"bridge{uav}" for uav in _UAVS])
        while set(modes := self.modes()) != {"HOLD"} or sum(r.armed for r in records(folder)) < 2:
            for uav in (uav for uav, mode in zip(_UAVS, modes, strict=True) if not mode):
                send_fault(self._control, f"{uav} takeoff now")
            time.sleep(0.5)  # the stand-ins tell their state when asked, and give no notice

    def modes(self) -> list[str]:
        """The mode of each vehicle, empty when it is disarmed."""
        states = json.loads(send_fault(self._control, "all state"))[: len(_UAVS)]
        return [state["mode"] if state["armed"] else "" for state in states]

    def strike(self, uav: int, what: str) -> None:
        """Kill the process of a bridge, stop it, or have another one in its place."""
        if uav in self._processes:
            self._processes[uav].send_signal(signal.SIGSTOP if what == "stop" else signal.SIGKILL)
        if what == "restart":
            words = ("ptnsbc_nodes.bridge.bridge_main", "--scenario", self._scenario, "--uav", uav)
            with (self.folder / f"bridge{uav}.log").open("wb") as log:
                self._processes[uav] = subprocess.Popen([*_PYTHON, *map(str, words)], stderr=log)


def run_once(bridges: Bridges, order: str, chance: random.Random) -> tuple[str, list[float]]:
    """One order after strikes at random moments: these, and the times until vehicles obeyed."""
    bridges.begin()
    struck = chance.sample(_UAVS, chance.choice((1, 1, 2)))
    strikes = {uav: (chance.choice(_STRIKES), chance.choice(("before", "after"))) for uav in struck}

    def strike(moment: str) -> None:
        for uav, (what, when) in strikes.items():
            if when == moment:
                bridges.strike(uav, what)
                time.sleep(chance.uniform(0.0, _WITHIN_S))  # no event marks the moment

    strike("before")
    words = ("stop", "--ready", "--patience", _PATIENCE_S, *(["--kill"] * (order == "kill")))
    with program(bridges.folder, "stop", bridges.domain, "ptnsbc_tools.cli", *words) as terminal:
        wait_for(terminal, ["ready: any key"])
        strike("after")
        assert terminal.process.stdin is not None
        terminal.process.stdin.write(b"\n")
        terminal.process.stdin.flush()
        pressed_s, seconds = time.monotonic(), dict[int, float]()
        while len(seconds) < len(_UAVS) and (now_s := time.monotonic()) - pressed_s < _OBEYED_S:
            for uav, mode in zip(_UAVS, bridges.modes(), strict=True):
                if not mode or (order == "land" and mode == "LAND"):
                    seconds.setdefault(uav, now_s - pressed_s)
            time.sleep(0.01)  # the same; it bounds the error of the times
        code = terminal.process.wait(PATIENCE_S)
        if len(seconds) < len(_UAVS):
            print(terminal.log.read_text(), flush=True)
    return f"{order} after {strikes}: exit code {code}", list(seconds.values())


def main() -> None:
    """Strike, stop, and print the distribution of the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=200, help="trials")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    chance, times = random.Random(arguments.seed), dict[str, list[float]](land=[], kill=[])
    with tempfile.TemporaryDirectory(prefix="bench-") as name, free_domain() as domain:
        os.environ.update(XDG_RUNTIME_DIR=name, ROS_DOMAIN_ID=str(domain))
        scenario, control = write_scenario(Path(name), 600.0)
        bridges = Bridges(Path(name), domain, scenario, control)
        with stand_ins(Path(name), domain, scenario, control):
            for turn in range(arguments.times):
                order = ("land", "kill")[turn % 2]
                text, seconds = run_once(bridges, order, chance)
                times[order] += seconds
                print(
                    f"{turn + 1} {text}, {' '.join(f'{one:.2f}' for one in seconds)} s", flush=True
                )
        for uav in _UAVS:
            bridges.strike(uav, "kill")
    for order, found in times.items():
        found.sort()
        tail = f"90 % {found[int(0.9 * (len(found) - 1))]:.2f} s, largest {found[-1]:.2f} s"
        print(f"{order}: {len(found)} vehicles, median {found[len(found) // 2]:.2f} s, {tail}")
    raise SystemExit(sum(map(len, times.values())) < len(_UAVS) * arguments.times)


if __name__ == "__main__":
    main()
