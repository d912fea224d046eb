"""`ptnsbc fleet` and `ptnsbc demo`: a process per UAV, recorded, and the verdict from the bag."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.signals import restore_handlers
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import console, result, ros
from ptnsbc_tools.reading.bag_reader import read_recording
from ptnsbc_tools.verdict import verdict_on

if TYPE_CHECKING:
    from ptnsbc_nodes.fleet.fleet import FleetOptions, FleetResult

DEMO_SCENARIO = "paper_5"
_NO_VERDICT = 1


@dataclass(frozen=True)
class FleetRequest:
    """How a fleet is to be flown, and what is to be kept of it."""

    lockstep: bool
    backend: Literal["sim", "mavlink"] = "sim"
    allow_arming: bool = False
    bag: Path | None = None
    overwrite: bool = False
    picture: Path | None = None
    json: bool = False
    only: str = ""  # processes of this computer, all if empty


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _options(scenario: Scenario, wishes: FleetRequest) -> FleetOptions:
    with ros.needed(f"{ros.WAY_OUT}, or fly without it: ptnsbc simulate"):
        from ptnsbc_nodes.fleet.fleet import FleetOptions, chosen
    return FleetOptions(
        scenario,
        lockstep=wishes.lockstep,
        backend=wishes.backend,
        allow_arming=wishes.allow_arming,
        bag=wishes.bag,
        overwrite=wishes.overwrite,
        only=chosen(wishes.only, scenario, wishes.backend) if wishes.only else frozenset(),
    )


def _fly(options: FleetOptions) -> FleetResult:
    from ptnsbc_nodes.fleet.fleet import run_fleet

    try:
        return run_fleet(options, _say)
    finally:
        restore_handlers()


def _facts(flown: FleetResult) -> dict[str, Any]:
    """What the processes have to add to the verdict."""
    return {
        "startup_s": round(flown.startup_s, 3),
        "flight_s": round(flown.flight_s, 3),
        "died": list(flown.died),
        "interrupted": flown.interrupted,
        "recorded": {key: flown.recorded.get(key) for key in ("messages", "lost", "late")},
        "logs": str(flown.processes[0].log.parent) if flown.processes else None,
    }


def _losses(flown: FleetResult) -> Iterator[str]:
    """What the flight and its recording lack, one line each."""
    for name in flown.died:
        yield f"{name} ended before its time"
    recorded = flown.recorded
    if not recorded:
        yield "the recorder left no count of its messages: the bag may be cut"
    if recorded.get("lost"):
        yield f"the recorder lost {recorded['lost']} of {recorded.get('messages', 0)} messages"
    if recorded.get("late"):
        yield f"{recorded['late']} messages came too late to be sorted: bytes differ between runs"


def _judged(bag: Path, flown: FleetResult, wishes: FleetRequest) -> int:
    """Judge and show the bag; without one that can be read, still tell how the flight ended."""
    extra: dict[str, Any] = {"bag": wishes.bag, "fleet": _facts(flown)}
    try:
        recording = read_recording(bag)
        verdict = verdict_on(recording)
    except PtnsbcError as error:
        line = " ".join(str(error).split())
        end = "was interrupted" if flown.interrupted else "is over"
        _say(f"error: the flight {end} after {flown.flight_s:.1f} s, but has no verdict: {line}")
        if wishes.json:
            kept = None if wishes.bag is None else str(wishes.bag)
            console.print_json({**extra, "verdict": None, "error": line, "bag": kept})
        return flown.exit_code or _NO_VERDICT
    if wishes.picture is not None:
        from ptnsbc_tools.plotting.picture import draw

        extra["picture"] = draw(recording, wishes.picture)
    result.show(verdict, json=wishes.json, extra=extra)
    return flown.exit_code or verdict.exit_code


def in_flight(scenario: Scenario) -> Iterator[str]:
    """What flying real vehicles changes in a scenario, one line each."""
    for key, value in scenario.mavlink.overrides.items():
        own: Any = scenario.file
        for name in key.split("."):
            own = getattr(own, name, None)
        before = "the default" if own is None else own
        yield f"in flight: {key}: {value} instead of {before} (mavlink.overrides)"


def fleet(scenario: Scenario, wishes: FleetRequest) -> int:
    """Fly with one process per UAV, judge the bag; returns the exit code."""
    if wishes.backend == "mavlink":
        for line in in_flight(scenario):
            _say(line)
        scenario = scenario.bridged()
    result.preflight(scenario, quiet=wishes.json)
    options = _options(scenario, wishes)
    if not options.leads:
        return _taken_part(_fly(options), wishes)
    with ExitStack() as stack:
        bag = wishes.bag
        if bag is None:  # the verdict needs one all the same
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="ptnsbc-"))
            bag = Path(folder) / "bag"
        flown = _fly(replace(options, bag=bag))
        for line in _losses(flown):
            _say(line)
        if flown.interrupted and not bag.exists():
            return flown.exit_code
        return _judged(bag, flown, wishes)


def _taken_part(flown: FleetResult, wishes: FleetRequest) -> int:
    """How it went on a computer that flew a part of the fleet: the verdict is where the bag is."""
    for name in flown.died:
        _say(f"{name} ended before its time")
    _say(f"over after {flown.flight_s:.1f} s; the verdict is on the computer with the recorder")
    if wishes.json:
        facts = _facts(flown)
        del facts["recorded"]
        console.print_json({"fleet": facts})
    return flown.exit_code


def demo_wishes(folder: Path, *, json: bool) -> FleetRequest:
    """Lock-step, into a new folder named after the moment."""
    bag = folder / f"demo-{datetime.now():%Y%m%d-%H%M%S}"
    picture = bag.with_name(f"{bag.name}.png")
    return FleetRequest(lockstep=True, bag=bag, picture=picture, json=json)
