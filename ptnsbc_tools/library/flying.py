"""Scenarios, checks and flights: the functions behind `check`, `simulate`, `verify` and `fleet`."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text
from ptnsbc_sim.scenario.reading import reader
from ptnsbc_sim.track import refuse_without_memory
from ptnsbc_sim.verdict import Verdict, verdict_on
from ptnsbc_tools import console, ros
from ptnsbc_tools.check import ERROR, WARNING, CheckReport
from ptnsbc_tools.check import check as findings_of
from ptnsbc_tools.library.flight import Flight, flight_in
from ptnsbc_tools.limits import DRY_RUNS, FARTHEST_M, FINEST_M, MOST_RUNS, path_of, refuse_outside
from ptnsbc_tools.options import AS_RECORDED, ReadOptions
from ptnsbc_tools.reading.bag_reader import read_status


class FlightFailedError(PtnsbcError):
    """A fleet that did not fly to the end."""


ScenarioLike: TypeAlias = Scenario | str | Path | Mapping[str, Any]
"""Form in which every function takes a scenario: see `load`."""


def load(scenario: ScenarioLike, /, **keys: Any) -> Scenario:
    """A scenario: a shipped one by name, a file by path, or a mapping with the keys of a file.

    Args:
        scenario: `"paper_5"`, a path, a mapping such as `{"extends": "paper_5", "seed": 3}`, or a scenario.
        keys: dotted keys to set, as in `load("paper_5", **{"timing.duration_s": 8})`.

    Raises:
        ScenarioError: no such file, or a file that describes no flight; it names key, value and expectation.
    """
    given = {key: reader.plain(value) for key, value in keys.items()}
    if isinstance(scenario, Scenario):
        return scenario.with_(given) if given else scenario
    if not isinstance(scenario, Mapping):
        return load_scenario(scenario, given)
    return scenario_from_text(
        reader.dump(reader.plain(scenario)), given, source="mapping", folder=Path.cwd()
    )


def check(
    scenario: ScenarioLike,
    *,
    dry_runs: int = DRY_RUNS,
    progress: bool | None = None,
    strict: bool = False,
) -> CheckReport:
    """Check a scenario before a flight, as `ptnsbc check`: by closed forms, then by dry runs.

    `dry_runs` perturbed flights are flown when the rest finds no error; 0: none. `strict` refuses a scenario whose
    flight will be *met late*.
    """
    from ptnsbc_tools.check.dry_run import flown, plan

    refuse_outside("dry_runs", dry_runs, 0, MOST_RUNS)
    scenario = load(scenario)
    with console.compiling():
        findings = findings_of(scenario)
    flights = None
    if dry_runs and all(finding.severity != ERROR for finding in findings):
        report = flown(scenario, dry_runs, progress, strict=strict)
        findings, flights = [*report, *findings], report.flown
    told = plan(scenario, findings, flights)
    return CheckReport(scenario, tuple(findings), flights, told)


def fly(scenario: ScenarioLike, *, checked: bool = True, progress: bool | None = None) -> Flight:
    """Fly a scenario in this process, as `ptnsbc simulate`; the same scenario gives the same bytes.

    The first flight after an installation compiles the laws, which takes some 25 s.

    Args:
        checked: check it first: errors are raised, warnings are Python warnings. False: no check.

    Raises:
        CheckError: the pre-flight check refuses the scenario.
        ScenarioError: the flight does not fit into the memory of this computer.
    """
    scenario = load(scenario)
    refuse_without_memory(scenario)
    if checked:
        report = check(scenario, dry_runs=0)
        report.refuse()
        for one in (finding for finding in report if finding.severity == WARNING):
            warnings.warn(f"{scenario.name}: {one}", stacklevel=2)
    from ptnsbc_sim.swarm import fly as fly_headless  # loads numba: only after all checks
    from ptnsbc_sim.verdict.recording import recording_of

    one_tick = {"timing.duration_s": 1 / scenario.timing.control_hz}
    with console.compiling():  # the flight's own progress would stand still
        fly_headless(scenario.with_(one_tick))
    with console.progress("flying", progress) as advance:
        headless = fly_headless(scenario, advance)
    return Flight(recording_of(headless), headless=headless)


def read_bag(
    path: str | Path,
    *,
    scenario: str | Path | None = None,
    tolerance_m: float | None = None,
    window_s: float | None = None,
    epoch_s: float | None = None,
    odom: str = AS_RECORDED.odom,
    wrench: str = AS_RECORDED.wrench,
    mapped: Sequence[str] = (),
    frame: Literal["enu", "ned"] = "enu",
    origins: Sequence[str] = (),
) -> Flight:
    """The flight in a bag, of ours or of another program.

    Args:
        scenario: scenario file to use instead of the attached one.
        tolerance_m: limit of the error at the deadline; by default that of the scenario.
        epoch_s: epoch in seconds after the start, for a bag that has none.
        odom: topic of the states; {n} is the id of the UAV.
        wrench: topic of the wrench, where it is recorded.
        mapped, frame, origins: where the states of each UAV are and what they count from, as the options `--map`,
            `--frame` and `--origin` of `ptnsbc verify`.

    Raises:
        BagError: no bag, cut, damaged, or without a scenario.
        TopicPatternError: topics or origins that name no UAV.
        LimitError: a window or an epoch that no bag reaches, or a tolerance that is none.
    """
    given = None if scenario is None else path_of("scenario", scenario)
    sources = odom, wrench, list(mapped), frame, list(origins)
    options = ReadOptions(given, tolerance_m, window_s, *sources, epoch_s)
    return flight_in(path, options)


def verdict(
    flight: Flight | str | Path, tolerance_m: float | None = None, *, strict: bool = False
) -> Verdict:
    """The verdict on a flight, or on that of a bag, as `ptnsbc verify`; VerdictError when it cannot be judged.

    Args:
        tolerance_m: limit of the error at the deadline; by default as the flight says.
        strict: UAVs that gave way and came late have missed.
    """
    refuse_outside("tolerance_m", tolerance_m, FINEST_M, FARTHEST_M)
    flight = flight_in(flight)
    judged = flight.verdict if tolerance_m is None else verdict_on(flight.recording, tolerance_m)
    return judged.strict() if strict else judged


def fly_fleet(
    scenario: ScenarioLike,
    *,
    lockstep: bool = False,
    bag: str | Path | None = None,
    overwrite: bool = False,
    checked: bool = True,
) -> Flight:
    """Fly a scenario with one ROS 2 process per UAV and the simulator, as `ptnsbc fleet`, and read its bag.

    Call it from the main thread. Ctrl-C ends the flight in order.

    Args:
        lockstep: as fast as possible, with the same bytes every time; by default by the wall clock.
        bag: folder to record into; by default a temporary one, which is read and removed.
        overwrite: replace an existing bag.
        checked: check the scenario first.

    Raises:
        CheckError: the pre-flight check refuses the scenario.
        LibraryMissingError: ROS 2 is not installed.
        FlightFailedError: a process ended in flight, or Ctrl-C ended it.
    """
    scenario = load(scenario)
    if checked:
        check(scenario, dry_runs=0).refuse()
    with ros.required(f"{ros.INSTALL}, or fly without it: ptnsbc.fly"):
        from ptnsbc_nodes.fleet.fleet import FleetOptions, run_fleet
    with ExitStack() as stack:
        kept = None if bag is None else path_of("bag", bag)
        folder = kept or Path(stack.enter_context(tempfile.TemporaryDirectory())) / "bag"
        flown = run_fleet(
            FleetOptions(scenario, lockstep=lockstep, bag=folder, overwrite=overwrite)
        )
        if flown.died or flown.interrupted:
            why = f"{flown.losses} ended" if flown.died else "interrupted"
            raise FlightFailedError(
                f"{scenario.name}: {why} after {flown.flight_s:.1f} s of flight"
            )
        return replace(flight_in(folder), bag=kept, status=read_status(folder))
