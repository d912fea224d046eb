"""Ours against predefined-time sliding modes without a time base and a tuned linear cascade. Figs. 19-22.

Same plant, estimator and start, compared three ways: at the same nominal deadline, at the same actual
settling, and with actuators that give no more than twice the weight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

from ptnsbc_sim import baselines
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder
from ptnsbc_tools.reproduce.experiment_result import Cell, Column, ExperimentResult, Table
from ptnsbc_tools.reproduce.figures import rivals
from ptnsbc_tools.reproduce.flights import UNFILTERED, JudgedFlight, judged, scenario
from ptnsbc_tools.reproduce.rivalry import (
    CASES,
    PRINTED,
    compared,
    initial_claim,
    saturated_claim,
    spent_claim,
)

SCENARIO = "paper_5_free"
PREDEFINED = ("ptsmc_exponential", "ptsmc_two_sided")
CASCADE = "linear_cascade"
OPEN_CASCADE = f"{CASCADE}, filter opened"
PROFILES = ("paper", "soft", "reference")
DURATION_S = 15.0
MATCHED_S = 0.1  # by how much two settling times may differ and still be called the same
WEIGHTS = 2.0  # what limited actuators give, in weights
BEST = "soft"

_COLUMNS = (
    Column("law"),
    Column("nominal deadline, s"),
    Column("within 0.05 m at 5 s"),
    Column("settled, s"),
    Column("error at 5 s, m", 4),
    Column("input at 0 s", 1),
    Column("largest in 0.1 s", 1),
    Column("peak input", 1),
    Column("at, s"),
    Column("energy (54), N²s", 0),
    Column("beyond hover, N²s", 0),
)


class LawVariant(NamedTuple):
    """How a law is flown."""

    profile: str = BEST
    filtered: bool = True
    limit_n: float | None = None
    settle_s: float | None = None
    name: str = SCENARIO
    open_filter: bool = False  # as little as lets the cascade settle in time


def _chosen(way: LawVariant) -> Scenario:
    """The six-input plant in free space: the baselines avoid nothing."""
    settings = {
        "plant.kind": "rigid_body_6dof",
        "gains.profile": way.profile,
        "timing.duration_s": DURATION_S,
        "world.obstacles": [],
        **({} if way.filtered else UNFILTERED),
    }
    return scenario(way.name, settings)


@lru_cache(maxsize=32)
def flight(law: str, way: LawVariant) -> JudgedFlight:
    """One law, flown and judged."""
    chosen = _chosen(way)
    flown = baselines.fly(chosen, law, way.limit_n, way.settle_s, open_filter=way.open_filter)
    return judged(flown)


def ours(name: str = SCENARIO, limit_n: float | None = None) -> dict[str, JudgedFlight]:
    """The method as printed, and under its three profiles behind the command filter."""
    way = LawVariant(name=name, limit_n=limit_n)
    printed = way._replace(profile="paper", filtered=False)
    found = {PRINTED: flight("ours", printed)}
    return {**found, **{f"ours, {p}": flight("ours", way._replace(profile=p)) for p in PROFILES}}


def _rivals(way: LawVariant) -> dict[str, JudgedFlight]:
    """The baselines; where no gain makes the cascade settle in time, behind a command filter opened for it."""
    found = {law: flight(law, way) for law in PREDEFINED}
    try:
        found[CASCADE] = flight(CASCADE, way)
    except baselines.BaselineError:
        found[OPEN_CASCADE] = flight(CASCADE, way._replace(open_filter=True))
    return found


def same_deadline(name: str = SCENARIO, limit_n: float | None = None) -> dict[str, JudgedFlight]:
    """All laws, promised the scenario's deadline; the cascade tuned to settle by it."""
    return {**ours(name, limit_n), **_rivals(LawVariant(name=name, limit_n=limit_n))}


def same_settling(settle_s: float) -> dict[str, JudgedFlight]:
    """All laws, tuned to settle when ours does with its deadline; with the printed gains it never settles."""
    other = flight("ours", LawVariant(profile="reference", settle_s=settle_s))
    return {**ours(), "ours, reference": other, **_rivals(LawVariant(settle_s=settle_s))}


def cascade_settling() -> tuple[float, dict[str, JudgedFlight]]:
    """The earliest settling that the cascade can reach behind the command filter [s], and all laws tuned to it."""
    way = LawVariant()
    settle_s = baselines.earliest_s(_chosen(way))
    tuned = way._replace(settle_s=settle_s)
    mine = {f"ours, {p}": flight("ours", tuned._replace(profile=p)) for p in (BEST, "reference")}
    return settle_s, {**mine, **{law: flight(law, tuned) for law in (*PREDEFINED, CASCADE)}}


def _row(law: str, one: JudgedFlight, deadline_s: float) -> tuple[Cell, ...]:
    peak = max(one.verdict.efforts, key=lambda effort: effort.peak_input)
    size = len(one.verdict.uavs)
    return (
        law,
        one.scenario.gains.formation.deadline_s if CASCADE not in law else None,
        f"{one.within_at(deadline_s)} of {size}",
        one.settled_s(),
        one.worst_error_at(deadline_s),
        float(one.inputs[0].max()),
        one.initial_input(),
        one.peak_input(),
        peak.peak_at_s,
        one.verdict.energy,
        one.energy_beyond_hover(),
    )


def _table(
    name: str,
    title: str,
    flights: Mapping[str, JudgedFlight],
    laws: Sequence[str],
    settle_s: float | None = None,
) -> Table:
    """What all laws do; those that do not settle at `settle_s` are named."""
    deadline_s = flights[f"ours, {BEST}"].scenario.gains.formation.deadline_s
    rows = tuple(_row(law, one, deadline_s) for law, one in flights.items())
    told = []
    for mine in [case for case in (*CASES, "ours, reference") if case in flights]:
        parts = [f"{compared(flights, mine, law)} `{law}`" for law in laws if law in flights]
        told.append(f"of *{mine}* {', '.join(parts)}")
    meaning = f"The largest input of the first 0.1 s is, {'; '.join(told)}."
    if OPEN_CASCADE in flights:
        meaning += _opened(flights[OPEN_CASCADE].scenario)
    if settle_s is not None:
        meaning += _unmatched(flights, settle_s)
    return Table(name, title, _COLUMNS, rows, meaning)


def _opened(scenario: Scenario) -> str:
    limit = _chosen(LawVariant()).gains.filter.max_acceleration_m_s2
    wider, kappa = scenario.gains.filter.max_acceleration_m_s2, scenario.gains.formation.kappa_1_s
    return (
        f" Behind the command filter of {limit:g} m/s² no constant gain makes `{CASCADE}` settle in time: what it asks "
        f"for at the start is cut there. Behind one opened to {wider:.1f} m/s², no farther than it needs, "
        f"κ = {kappa:.2f} 1/s does."
    )


def _unmatched(flights: Mapping[str, JudgedFlight], settle_s: float) -> str:
    """The rows that a table of the same settling shows although they do not settle then."""
    settled = {law: one.settled_s() for law, one in flights.items()}
    told = [
        f"*{law}* " + ("never settles" if time is None else f"settles at {time:.2f} s")
        for law, time in settled.items()
        if time is None or abs(time - settle_s) > MATCHED_S
    ]
    if not told:
        return f" All settle within {MATCHED_S:g} s of the same moment."
    return f" No match, and shown for comparison only: {'; '.join(told)}."


def run(workshop: ExperimentFolder) -> ExperimentResult:
    """Fly, compare and draw."""
    workshop.tell("flying at the same deadline")
    nominal = same_deadline()
    wanted_s = nominal[f"ours, {BEST}"].settled_s() or 0.0
    workshop.tell("tuning for the same settling")
    matched = same_settling(wanted_s)
    workshop.tell("flying with limited actuators")
    limit_n = WEIGHTS * nominal[f"ours, {BEST}"].weight_n
    held = same_deadline(limit_n=limit_n)
    workshop.tell("flying twenty UAVs")
    twenty = same_deadline("paper_20")
    workshop.tell("tuning for the settling of the cascade")
    earliest_s, cascade = cascade_settling()
    laws = (*PREDEFINED, CASCADE, OPEN_CASCADE)
    moments = {"same_settling": wanted_s, "cascade_settling": earliest_s}
    titles = {
        "same_deadline": "The same nominal deadline, 5 s",
        "same_settling": f"The same actual settling, {wanted_s:.1f} s",
        "limited": f"The same nominal deadline, at most {limit_n:.1f} N",
        "cascade_settling": f"The earliest settling of `{CASCADE}` behind the command filter, {earliest_s:.1f} s",
        "twenty": "Twenty UAVs, the same nominal deadline",
    }
    sets = dict(zip(titles, (nominal, matched, held, cascade, twenty), strict=True))
    workshop.tell("drawing")
    return ExperimentResult(
        "baselines",
        "Baselines",
        f"Scenario `{SCENARIO}`, {DURATION_S:g} s, six-input plant. The two controllers that the paper compares "
        "with could not be identified; `ptsmc_exponential` and `ptsmc_two_sided` are predefined-time sliding modes of "
        "the kind it describes. `linear_cascade` is ours without any time base, with the smallest constant gain that "
        "settles by the deadline (`ptnsbc_sim/baselines`). The printed law has no command filter; ours limits the "
        "commanded acceleration to 10 m/s² in every profile; *ours, paper, unfiltered* is the law without that limit.",
        figures=(
            *rivals.pair(workshop, nominal, PREDEFINED[0], (19, 20)),
            *rivals.pair(workshop, nominal, PREDEFINED[1], (21, 22)),
            rivals.all_laws(workshop, {titles[k]: sets[k] for k in list(titles)[:3]}),
        ),
        tables=tuple(
            _table(name, titles[name], some, laws, moments.get(name)) for name, some in sets.items()
        ),
        claims=(
            initial_claim("initial_input", nominal, matched, 60.0, PREDEFINED),
            initial_claim("twenty_initial_input", twenty, None, 66.0, PREDEFINED),
            saturated_claim(held, limit_n, PREDEFINED),
            spent_claim(nominal, matched, PREDEFINED),
        ),
    )
