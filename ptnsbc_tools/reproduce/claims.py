"""Claims of the paper against flights of this code. Pure functions: tests call them on short flights.

Flights are named by their gain profile, or, where laws are compared, by the law: `ours, soft`, `ptsmc_exponential`, …
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ptnsbc_tools.reproduce.experiment_result import Claim
from ptnsbc_tools.reproduce.flights import JudgedFlight

Flights = Mapping[str, JudgedFlight]

HOLDS, FAILS = "holds", "does not hold"

_FORMATION = {
    "paper_5": ("formation_with_obstacles", "with obstacles on the way", "Figs. 5, 6, 9, 11"),
    "paper_5_free": ("formation_without_obstacles", "without obstacles", "Figs. 7, 8, 10, 12"),
}


def verdict(by_case: Mapping[str, bool], printed: str = "paper") -> str:
    """`holds` when the claim holds as printed, else `holds when` with the cases in which it does, if any."""
    good = [case for case, holds in by_case.items() if holds]
    if by_case.get(printed):
        return HOLDS
    return f"holds when {' or '.join(good)}" if good else FAILS


def _by_profile(good: Mapping[str, bool], printed: str = "paper") -> str:
    cases = {f"the profile is {profile}": holds for profile, holds in good.items()}
    return verdict(cases, f"the profile is {printed}")


def _kept(flights: Flights) -> dict[str, bool]:
    return {profile: one.kept_promise() for profile, one in flights.items()}


def formation_claim(scenario: str, flights: Flights) -> Claim:
    """All UAVs in formation within the deadline, for each profile."""
    key, where, figures = _FORMATION[scenario]
    ours = [
        f"{profile}: {one.met_text()} UAVs, error at 5 s at most {one.worst_at_deadline_m():.3f} m"
        for profile, one in flights.items()
    ]
    return Claim(
        key,
        f"All five UAVs are in formation within the time chosen beforehand, {where}",
        "5 s",
        "; ".join(ours),
        _by_profile(_kept(flights)),
        figures,
    )


def velocity_claim(flights: Flights) -> Claim:
    """The velocity error stays within the sliding boundary from tf3 on."""
    gains = next(iter(flights.values())).scenario.gains
    deadline_s, width = gains.force.deadline_s, gains.boundary.velocity_m_s
    worst = {profile: one.velocity_error_after(deadline_s) for profile, one in flights.items()}
    ours = [f"{profile}: {value:.3f} m/s at most" for profile, value in worst.items()]
    return Claim(
        "velocity_error",
        "The controller brings the velocity to its command within a time chosen beforehand",
        "into a neighbourhood of zero, (A.11)",
        f"after tf3 = {deadline_s:g} s, width of the sliding boundary {width:g} m/s: "
        + "; ".join(ours),
        _by_profile({profile: value <= width for profile, value in worst.items()}),
        "table *Every flight of Simulation 1*",
    )


def twenty_formation_claim(flights: Flights) -> Claim:
    """Twenty UAVs in formation by the deadline, past the obstacles."""
    ours = [
        f"{profile}: {one.met_text()} UAVs, room beyond keep-outs at least {one.clearance_m():.3f} m"
        for profile, one in flights.items()
    ]
    return Claim(
        "twenty_formation",
        "Twenty UAVs take up a fixed formation, follow the trajectory and avoid the obstacles",
        "20 UAVs",
        "; ".join(ours),
        _by_profile(_kept(flights)),
        "Figs. 24, 25, 26",
    )


def twenty_inputs_claim(flights: Flights, limit_n: float) -> Claim:
    """No input of any UAV above a limit; the first of the flights is the printed law."""
    peaks = {profile: one.peak_input() for profile, one in flights.items()}
    return Claim(
        "twenty_inputs",
        "With twenty UAVs every input stays below a limit",
        f"{limit_n:.0f} N",
        "; ".join(f"{profile}: {peak:.1f} at most" for profile, peak in peaks.items()),
        _by_profile(
            {profile: peak < limit_n for profile, peak in peaks.items()}, next(iter(peaks))
        ),
        "Figs. 27 to 31",
    )


def experiment_claim(
    flights: Sequence[JudgedFlight], fresh: Sequence[JudgedFlight], calm: JudgedFlight
) -> Claim:
    """Four quadrotors form up and follow, with every seed of the disturbances and without disturbances.

    Args:
        flights: with seeds for which the gains were chosen.
        fresh: with other seeds.
        calm: without disturbances.
    """
    every = [*flights, *fresh]
    good, unseen = (sum(one.kept_promise() for one in some) for some in (every, fresh))
    worst = max(one.worst_at_deadline_m() for one in every)
    if good == len(every):
        found = HOLDS
    else:
        found = f"holds when lucky: {good} of {len(every)} draws" if good else FAILS
    return Claim(
        "experiment",
        "Four real quadrotors take up the formation and follow the trajectory",
        "shown in photographs",
        f"simulated: all UAVs in place from the deadline on in {good - unseen} of {len(flights)} draws on which gains "
        f"were chosen and in {unseen} of {len(fresh)} fresh ones, error at it at most {worst:.3f} m (tolerance "
        f"{calm.verdict.uavs[0].tolerance_m:g} m); with nothing left to chance {calm.worst_at_deadline_m():.3f} m",
        found,
        "Figs. 33, 34",
    )


PRINTED = "ours, paper, unfiltered"
SOFT = "ours, soft"
# Our variants, each with its name in a list and in a condition.
CASES = {
    PRINTED: ("printed gains, no command filter", "printed"),
    "ours, paper": (
        "printed gains behind the command filter",
        "the printed gains are flown behind a command filter",
    ),
    SOFT: ("profile soft", "the profile is soft"),
}


def _by_case(good: Mapping[str, bool]) -> str:
    return verdict({CASES[mine][1]: holds for mine, holds in good.items()}, CASES[PRINTED][1])


def initial_reduction(flights: Flights, mine: str, law: str) -> float:
    """By how many percent our initial input is below that of a law; negative when above."""
    return 100.0 * (1.0 - flights[mine].initial_input() / flights[law].initial_input())


def _least_reduction(flights: Flights, laws: Sequence[str]) -> dict[str, float]:
    """The smallest reduction against any of the laws, by case of ours."""
    return {mine: min(initial_reduction(flights, mine, law) for law in laws) for mine in CASES}


def _listed(reductions: Mapping[str, float]) -> str:
    return ", ".join(
        f"{CASES[mine][0]} {abs(value):.0f} % {'lower' if value >= 0 else 'higher'}"
        for mine, value in reductions.items()
    )


def initial_claim(
    key: str, flights: Flights, matched: Flights | None, percent: float, laws: Sequence[str]
) -> Claim:
    """Initial input at least `percent` below that of predefined-time control without a time base."""
    least = _least_reduction(flights, laws)
    newtons = [f"{law} {one.initial_input():.0f}" for law, one in flights.items()]
    ours = f"against the gentler of the two: {_listed(least)} (inputs: {', '.join(newtons)})"
    if matched is not None:
        other = _listed(_least_reduction(matched, laws))
        ours += f". The baselines tuned to settle when profile soft does: {other}"
    many = len(flights[SOFT].uavs) > 5
    return Claim(
        key,
        ("With twenty UAVs the" if many else "The")
        + " initial input is far below that of predefined-time control without a time base",
        f"at least {percent:.0f} %" + ("" if many else "; 300 N for 4000 N and 1500 N"),
        ours,
        _by_case({mine: value >= percent for mine, value in least.items()}),
        "table *Twenty UAVs*" if many else "Figs. 19 to 22, A2",
    )


def saturated_claim(flights: Flights, limit_n: float, laws: Sequence[str]) -> Claim:
    """Only ours keeps the deadline with limited actuators: the stated use of the smaller input."""
    deadline_s, size = flights[SOFT].deadline_s, len(flights[SOFT].uavs)
    within = {law: one.within_at(deadline_s) for law, one in flights.items()}
    others = [law for law in laws if within[law] == size]
    found = _by_case({mine: within[mine] == size for mine in CASES})
    if others and found != FAILS:
        found += f"; {' and '.join(others)} {'do' if len(others) > 1 else 'does'} too"
    return Claim(
        "limited_actuators",
        "Its inputs suit the limits of real motors better than those of the others",
        "no number",
        f"with {limit_n:.1f} N at most, within 0.05 m at {deadline_s:g} s: "
        + ", ".join(f"{law} {good} of {size}" for law, good in within.items()),
        found,
        "table *at most*, Fig. A2",
    )


def energy_claim(flights: Flights, matched: Flights, laws: Sequence[str]) -> Claim:
    """Less energy than predefined-time control without a time base."""
    nominal, tuned = (
        min(some[law].energy_beyond_hover() for law in laws) for some in (flights, matched)
    )
    spent = {mine: flights[mine].energy_beyond_hover() for mine in CASES}
    ours = ", ".join(f"{CASES[mine][0]} {value:.0f} N²s" for mine, value in spent.items())
    return Claim(
        "energy",
        "Energy (54) is a second indicator of a controller; here against the baselines",
        "a figure; no number, nothing compared",
        f"beyond hover: {ours}; the better baseline {nominal:.0f} N²s, tuned to settle when ours does "
        f"{tuned:.0f} N²s",
        _by_case({mine: value < nominal for mine, value in spent.items()}),
        "Fig. 23",
    )
