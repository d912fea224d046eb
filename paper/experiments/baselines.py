"""Ours against predefined-time sliding modes without a time base and a tuned linear cascade. Figs. 19-22.

Plant, estimator and start are the same. The laws are compared in three ways: at the same nominal deadline, at the
same actual settling, and with actuators that give no more than twice the weight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

from paper import baselines
from paper import columns as col
from paper.claims import (
    CASES,
    PRINTED,
    SOFT,
    energy_claim,
    initial_claim,
    initial_reduction,
    saturated_claim,
)
from paper.columns import FlightColumn, flights_table
from paper.experiment_result import ExperimentResult, Table
from paper.figures import inputs
from paper.flights import PROFILES, UNFILTERED, JudgedFlight, judge, scenario
from paper.output import ExperimentFolder
from paper.swept import RUNS
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.sweep.draws import parse_starts
from ptnsbc_sim.sweep.plan import drawn_scenario, plan_of
from ptnsbc_tools.sweeps.summary import Share, share

SCENARIO = "paper_5_free"
PREDEFINED = ("ptsmc_exponential", "ptsmc_two_sided")
CASCADE = "linear_cascade"
OPEN_CASCADE = f"{CASCADE}, filter opened"
DURATION_S = 15.0
MATCHED_S = 0.1  # two settling times that differ by less are called the same
WEIGHTS = 2.0  # the force of limited actuators, in weights
_PAST_S = 0.1  # a flight from a drawn start ends this long after the deadline


class LawVariant(NamedTuple):
    """One way to fly a law."""

    profile: str = "soft"
    filtered: bool = True
    limit_n: float | None = None
    settle_s: float | None = None
    name: str = SCENARIO
    open_filter: bool = False  # no farther than the cascade needs to settle in time


def _scenario(variant: LawVariant) -> Scenario:
    """The six-input plant in free space: the baselines avoid nothing."""
    settings = {
        "plant.kind": "rigid_body_6dof",
        "gains.profile": variant.profile,
        "timing.duration_s": DURATION_S,
        "world.obstacles": [],
        **({} if variant.filtered else UNFILTERED),
    }
    return scenario(variant.name, settings)


@lru_cache(maxsize=32)
def flight(law: str, variant: LawVariant) -> JudgedFlight:
    """One law, flown and judged."""
    flown = baselines.fly(
        _scenario(variant), law, variant.limit_n, variant.settle_s, open_filter=variant.open_filter
    )
    return judge(flown)


def ours(name: str = SCENARIO, limit_n: float | None = None) -> dict[str, JudgedFlight]:
    """The method as printed, and under its three profiles behind the command filter."""
    variant = LawVariant(name=name, limit_n=limit_n)
    printed = variant._replace(profile="paper", filtered=False)
    found = {PRINTED: flight("ours", printed)}
    return {
        **found,
        **{f"ours, {p}": flight("ours", variant._replace(profile=p)) for p in PROFILES},
    }


def _others(variant: LawVariant) -> dict[str, JudgedFlight]:
    """The baselines; where no gain makes the cascade settle in time, behind a command filter opened for it."""
    found = {law: flight(law, variant) for law in PREDEFINED}
    try:
        found[CASCADE] = flight(CASCADE, variant)
    except baselines.BaselineError:
        found[OPEN_CASCADE] = flight(CASCADE, variant._replace(open_filter=True))
    return found


def same_deadline(name: str = SCENARIO, limit_n: float | None = None) -> dict[str, JudgedFlight]:
    """All laws, promised the scenario's deadline; the cascade tuned to settle by it."""
    return {**ours(name, limit_n), **_others(LawVariant(name=name, limit_n=limit_n))}


def same_settling(settle_s: float) -> dict[str, JudgedFlight]:
    """All laws, tuned to settle when ours does with its deadline; ours with the printed gains never settles."""
    other = flight("ours", LawVariant(profile="reference", settle_s=settle_s))
    return {**ours(), "ours, reference": other, **_others(LawVariant(settle_s=settle_s))}


def cascade_settling() -> tuple[float, dict[str, JudgedFlight]]:
    """The earliest settling that the cascade can reach behind the command filter [s], and all laws tuned to it."""
    variant = LawVariant()
    settle_s = baselines.earliest_s(_scenario(variant))
    tuned = variant._replace(settle_s=settle_s)
    mine = {f"ours, {p}": flight("ours", tuned._replace(profile=p)) for p in ("soft", "reference")}
    return settle_s, {**mine, **{law: flight(law, tuned) for law in (*PREDEFINED, CASCADE)}}


def shares_in_time(
    flights: Mapping[str, JudgedFlight], runs: int = RUNS, starts: str = "near:0.3"
) -> dict[str, Share]:
    """Share of flights whose UAVs are all within the tolerance at the deadline, by law, from drawn starts.

    Each law stays tuned as in its flight of `flights`. Flight k of every law starts from the same places.
    """
    found = {}
    for law, one in flights.items():
        plan = plan_of(
            one.scenario,
            runs,
            starts=parse_starts(starts),
            stop_after_s=one.deadline_s + _PAST_S,
            name=law,
        )
        kind = CASCADE if law == OPEN_CASCADE else law if law in baselines.LAWS else "ours"
        drawn = (drawn_scenario(plan, k)[0] for k in range(runs))
        flown = (judge(baselines.fly_tuned(some, kind)) for some in drawn)
        found[law] = share(sum(f.within_at(f.deadline_s) == len(f.uavs) for f in flown), runs)
    return found


def _columns(flights: Mapping[str, JudgedFlight]) -> tuple[FlightColumn, ...]:
    deadline_s = flights[SOFT].deadline_s
    names = {id(one): law for law, one in flights.items()}

    def law(one: JudgedFlight) -> str:
        return names[id(one)]

    def nominal_s(one: JudgedFlight) -> float | None:
        return None if CASCADE in law(one) else one.deadline_s

    def peak_at_s(one: JudgedFlight) -> float:
        return max(one.verdict.efforts, key=lambda effort: effort.peak_input).peak_at_s

    return (
        FlightColumn("law", law),
        FlightColumn("nominal deadline, s", nominal_s),
        FlightColumn(
            "within 0.05 m at 5 s", lambda one: f"{one.within_at(deadline_s)} of {len(one.uavs)}"
        ),
        col.SETTLED,
        FlightColumn("error at 5 s, m", lambda one: float(one.errors_at(deadline_s).max()), 4),
        FlightColumn("input at 0 s", lambda one: float(one.inputs[0].max()), 1),
        FlightColumn("largest in 0.1 s", JudgedFlight.initial_input, 1),
        col.PEAK_INPUT,
        FlightColumn("at, s", peak_at_s),
        col.ENERGY,
        col.BEYOND_HOVER,
    )


def _table(
    name: str,
    title: str,
    flights: Mapping[str, JudgedFlight],
    laws: Sequence[str],
    settle_s: float | None = None,
) -> Table:
    """One row for each law; the meaning names those that do not settle at `settle_s`."""
    compared = []
    for mine in [case for case in (*CASES, "ours, reference") if case in flights]:
        reductions = {law: initial_reduction(flights, mine, law) for law in laws if law in flights}
        parts = [
            f"{abs(percent):.0f} % {'below' if percent >= 0 else 'above'} `{law}`"
            for law, percent in reductions.items()
        ]
        compared.append(f"of *{mine}* {', '.join(parts)}")
    meaning = f"The largest input of the first 0.1 s is, {'; '.join(compared)}."
    if OPEN_CASCADE in flights:
        meaning += _opened(flights[OPEN_CASCADE].scenario)
    if settle_s is not None:
        meaning += _unmatched(flights, settle_s)
    return flights_table(name, title, _columns(flights), flights.values(), meaning)


def _opened(scenario: Scenario) -> str:
    limit = _scenario(LawVariant()).gains.filter.max_acceleration_m_s2
    wider, kappa = scenario.gains.filter.max_acceleration_m_s2, scenario.gains.formation.kappa_1_s
    return (
        f" Behind the command filter of {limit:g} m/s² no constant gain makes `{CASCADE}` settle in time: what it asks "
        f"for at the start is cut there. Behind one opened to {wider:.1f} m/s², no farther than it needs, "
        f"κ = {kappa:.2f} 1/s does."
    )


def _unmatched(flights: Mapping[str, JudgedFlight], settle_s: float) -> str:
    """The rows that a table of the same settling shows although they do not settle then."""
    settled = {law: one.settled_s() for law, one in flights.items()}
    others = [
        f"*{law}* " + ("never settles" if time is None else f"settles at {time:.2f} s")
        for law, time in settled.items()
        if time is None or abs(time - settle_s) > MATCHED_S
    ]
    if not others:
        return f" All settle within {MATCHED_S:g} s of the same moment."
    return f" No match, and shown for comparison only: {'; '.join(others)}."


class _Flown(NamedTuple):
    """All flights of the comparison, by law."""

    nominal: Mapping[str, JudgedFlight]
    matched: Mapping[str, JudgedFlight]
    limited: Mapping[str, JudgedFlight]
    cascade: Mapping[str, JudgedFlight]
    twenty: Mapping[str, JudgedFlight]
    shares: Mapping[str, Share]
    wanted_s: float  # settling of ours: `matched` is tuned for it
    limit_n: float  # of the actuators in `limited`
    earliest_s: float  # settling of `cascade`


def _fly(output: ExperimentFolder) -> _Flown:
    output.progress("flying at the same deadline")
    nominal = same_deadline()
    wanted_s = nominal[SOFT].settled_s() or 0.0
    output.progress("tuning for the same settling")
    matched = same_settling(wanted_s)
    output.progress("flying with limited actuators")
    limit_n = WEIGHTS * nominal[SOFT].weight_n
    limited = same_deadline(limit_n=limit_n)
    output.progress(f"flying each law with limited actuators from {RUNS} starts")
    shares = shares_in_time(limited)
    output.progress("flying twenty UAVs")
    twenty = same_deadline("paper_20")
    output.progress("tuning for the settling of the cascade")
    earliest_s, cascade = cascade_settling()
    return _Flown(nominal, matched, limited, cascade, twenty, shares, wanted_s, limit_n, earliest_s)


def run(output: ExperimentFolder) -> ExperimentResult:
    """Fly, compare and draw."""
    flown = _fly(output)
    nominal, matched, limit_n = flown.nominal, flown.matched, flown.limit_n
    titles = {
        "same_deadline": "The same nominal deadline, 5 s",
        "same_settling": f"The same actual settling, {flown.wanted_s:.1f} s",
        "limited": f"The same nominal deadline, at most {limit_n:.1f} N",
        "cascade_settling": f"The earliest settling of `{CASCADE}` behind the command filter, {flown.earliest_s:.1f} s",
        "twenty": "Twenty UAVs, the same nominal deadline",
    }
    sets = dict(
        zip(titles, (nominal, matched, flown.limited, flown.cascade, flown.twenty), strict=True)
    )
    settling_s = {"same_settling": flown.wanted_s, "cascade_settling": flown.earliest_s}
    laws = (*PREDEFINED, CASCADE, OPEN_CASCADE)
    output.progress("drawing")
    return ExperimentResult(
        "baselines",
        "Baselines",
        f"Scenario `{SCENARIO}`, {DURATION_S:g} s, six-input plant. The two controllers that the paper compares "
        "with could not be identified; `ptsmc_exponential` and `ptsmc_two_sided` are predefined-time sliding modes of "
        "the kind it describes. `linear_cascade` is ours without any time base, with the smallest constant gain that "
        "settles by the deadline (`paper/baselines`). The printed law has no command filter; ours limits the "
        "commanded acceleration to 10 m/s² in every profile; *ours, paper, unfiltered* is the law without that limit.",
        figures=(
            *inputs.compared_pair(output, nominal, PREDEFINED[0], (19, 20)),
            *inputs.compared_pair(output, nominal, PREDEFINED[1], (21, 22)),
            inputs.all_laws(output, {titles[key]: sets[key] for key in list(titles)[:3]}),
        ),
        tables=tuple(
            _table(name, titles[name], flights, laws, settling_s.get(name))
            for name, flights in sets.items()
        ),
        claims=(
            initial_claim("initial_input", nominal, matched, 60.0, PREDEFINED),
            initial_claim("twenty_initial_input", flown.twenty, None, 66.0, PREDEFINED),
            saturated_claim(flown.shares, flown.limited[SOFT].deadline_s, limit_n, PREDEFINED),
            energy_claim(nominal, matched, PREDEFINED),
        ),
    )
