"""`ptnsbc fleet` and `ptnsbc demo`: a process per UAV, recorded, and the verdict from the bag."""

from __future__ import annotations

import sys
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import result
from ptnsbc_tools.bag_reader import read_recording
from ptnsbc_tools.verdict import verdict_on

if TYPE_CHECKING:
    from ptnsbc_nodes.fleet import FleetResult

DEMO_SCENARIO = "paper_5"


class RosMissingError(PtnsbcError):
    """ROS 2 is not installed."""


@dataclass(frozen=True)
class Wishes:
    """How a fleet is to be flown, and what is to be kept of it."""

    lockstep: bool
    bag: Path | None = None
    overwrite: bool = False
    picture: Path | None = None
    json: bool = False


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _launch(scenario: Scenario, bag: Path, wishes: Wishes) -> FleetResult:
    from ptnsbc_nodes import environment

    environment.prepare()
    try:
        from ptnsbc_nodes.fleet import FleetOptions, run_fleet
    except ImportError as error:
        raise RosMissingError(
            f"{error.name} is not installed: install the extra [ros] or source ROS 2, or fly "
            "without it: ptnsbc simulate"
        ) from None
    options = FleetOptions(scenario, lockstep=wishes.lockstep, bag=bag, overwrite=wishes.overwrite)
    return run_fleet(options, _say)


def _facts(flown: FleetResult) -> dict[str, Any]:
    """What the processes have to add to the verdict."""
    return {
        "startup_s": round(flown.startup_s, 3),
        "flight_s": round(flown.flight_s, 3),
        "died": list(flown.died),
        "interrupted": flown.interrupted,
        "logs": str(flown.processes[0].log.parent) if flown.processes else None,
    }


def fleet(scenario: Scenario, wishes: Wishes) -> int:
    """Fly with one process per UAV, judge the bag; returns the exit code."""
    result.preflight(scenario, quiet=wishes.json)
    with ExitStack() as stack:
        bag = wishes.bag
        if bag is None:  # the verdict needs one all the same
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="ptnsbc-"))
            bag = Path(folder) / "bag"
        flown = _launch(scenario, bag, wishes)
        for name in flown.died:
            _say(f"{name} ended before its time")
        if flown.interrupted and not bag.exists():
            return flown.exit_code
        recording = read_recording(bag)
        verdict = verdict_on(recording)
        drawn = None
        if wishes.picture is not None:
            from ptnsbc_tools.picture import draw

            drawn = draw(recording, wishes.picture)
    extra = {"bag": wishes.bag, "picture": drawn, "fleet": _facts(flown)}
    result.show(verdict, json=wishes.json, extra=extra)
    return flown.exit_code or verdict.exit_code


def demo_wishes(folder: Path, *, json: bool) -> Wishes:
    """Lock-step, into a new folder named after the moment."""
    bag = folder / f"demo-{datetime.now():%Y%m%d-%H%M%S}"
    picture = bag.with_name(f"{bag.name}.png")
    return Wishes(lockstep=True, bag=bag, picture=picture, json=json)
