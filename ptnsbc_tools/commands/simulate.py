"""`ptnsbc simulate`: the whole swarm in this process, and its verdict."""

from __future__ import annotations

from pathlib import Path

from ptnsbc_sim.scenario import Scenario, scenario_from_text
from ptnsbc_tools import console, result
from ptnsbc_tools.verdict import Verdict, verdict_on


def simulate(scenario: Scenario, bag: Path | None, *, overwrite: bool, json: bool) -> Verdict:
    """Fly headless, record when asked, print the verdict."""
    # Compiling kernels takes seconds: not before the scenario is known to be worth it.
    from ptnsbc_tools.reading.flight_bag import prepare_bag, write_flight
    from ptnsbc_tools.reading.flight_recording import recording_of

    result.preflight(scenario, quiet=json)
    if bag is not None:
        prepare_bag(bag, overwrite=overwrite)

    from ptnsbc_sim.swarm import fly

    one_tick = {"timing.duration_s": 1 / scenario.control_hz}
    with console.compiling():  # or the flight would seem to stand still for a minute
        fly(scenario_from_text(scenario.text, one_tick, source=scenario.source))
    with console.progress("flying") as advance:
        flight = fly(scenario, advance)
    if bag is not None:
        with console.progress("recording") as advance:
            bag = write_flight(flight, bag, overwrite=overwrite, progress=advance)
    verdict = verdict_on(recording_of(flight))
    result.show(verdict, json=json, extra={"bag": bag})
    return verdict
