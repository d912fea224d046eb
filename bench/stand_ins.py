"""Fleets on four stand-ins over UDP, for benches: a scenario with free ports, and programs with a log."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

VEHICLES = (1, 2, 3, 4)
_LOOK_S = 0.1
PATIENCE_S = 600.0  # the laws are compiled once
BASE = Path(__file__).resolve().parents[1] / "scenarios" / "experiment_4.yaml"
# Four metres lower than the shipped file: otherwise climbing and landing take longer than a short flight.
SCENARIO = """
extends: {base}
timing: {{duration_s: {duration_s}}}
leader: {{trajectory: {{centre_m: [0, 0, 4]}}}}
mavlink:
  takeoff_height_m: 2
  vehicles:
"""


class Running(NamedTuple):
    """A program and its log."""

    process: subprocess.Popen[bytes]
    log: Path


def write_scenario(
    folder: Path, duration_s: float, *, autopilot: str = "px4", setpoint: str = "velocity"
) -> tuple[Path, int]:
    """A scenario of four vehicles of one kind, and the port at which their stand-ins take faults."""
    first = _free_ports()
    path = folder / "scenario.yaml"
    kind = f"autopilot: {autopilot}, setpoint: {setpoint}"
    links = "".join(
        f'    {i}: {{{kind}, connect: "udpin:127.0.0.1:{first + i}"}}\n' for i in VEHICLES
    )
    path.write_text(SCENARIO.format(base=BASE, duration_s=duration_s) + links)
    return path, first + 90


@contextmanager
def stand_ins(
    folder: Path,
    domain: int,
    scenario: Path,
    control: int,
    *,
    gnss: str = "rtk",
    seed: int = 1,
    parameters: Sequence[str] = ("COM_OF_LOSS_T=5", "COM_OBL_RC_ACT=5"),
) -> Iterator[Running]:
    """Four stand-ins that wait for their bridges, with these parameters of their firmware."""
    words = (
        "autopilot", "--scenario", scenario, "--gcs", "", "--boot-time", "0", "--gnss", gnss,
        "--seed", seed, "--control", control, *(word for one in parameters for word in ("--param", one)),
    )  # fmt: skip
    with program(folder, "stand_in", domain, "ptnsbc_tools.cli", *words) as vehicles:
        wait_for(vehicles, ["system 4 at"])
        yield vehicles


@contextmanager
def program(
    folder: Path, name: str, domain: int, module: str, *arguments: object
) -> Iterator[Running]:
    """A Python module as a process; it is ended after the `with`."""
    log = folder / f"{name}.log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", module, *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=out,
            stderr=out,
            env={**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONUNBUFFERED": "1"},
        )
    try:
        yield Running(process, log)
    finally:
        for number in (signal.SIGINT, signal.SIGINT, signal.SIGKILL):
            if process.poll() is None:
                process.send_signal(number)
                with suppress(subprocess.TimeoutExpired):
                    process.wait(30.0)


def wait_for(running: Running, texts: Sequence[str]) -> None:
    """Return when its log has all these texts; SystemExit with the log when it ends before."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline and running.process.poll() is None:
        lines = running.log.read_text(errors="replace")
        if all(text in lines for text in texts):
            return
        with suppress(subprocess.TimeoutExpired):  # a log that grows wakes nobody
            running.process.wait(_LOOK_S)
    raise SystemExit(f"{running.log.name} without {texts}:\n{running.log.read_text()[-3000:]}")


def _free_ports() -> int:
    with socket.socket(type=socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return min(port, 60000)
