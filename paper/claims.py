"""Claims of the paper against flights of this code. Pure functions: tests call them on short flights.

Flights are named by their gain profile, or, where laws are compared, by the law: `ours, soft`, `ptsmc_exponential`, …
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from paper.experiment_result import Claim
from paper.flights import JudgedFlight
from ptnsbc_tools.sweeps.summary import Share

Flights = Mapping[str, JudgedFlight]

SURE = 0.9
"""A claim holds when the lower bound of the Wilson interval of its share is above this."""

HOLDS, FAILS = "holds", "does not hold"

_FORMATION = {
    "paper_5": (
        "formation_with_obstacles",
        "All five UAVs are in formation within the time chosen beforehand, with obstacles on the way",
        "5 s",
    ),
    "paper_5_free": (
        "formation_without_obstacles",
        "All five UAVs are in formation within the time chosen beforehand, without obstacles",
        "5 s",
    ),
    "paper_20": (
        "twenty_formation",
        "Twenty UAVs take up a fixed formation, follow the trajectory and avoid the obstacles",
        "20 UAVs",
    ),
}
_LAWS = {
    "paper": "the gains are the printed ones",
    "soft": "the profile is soft",
    "ours": "the approach is planned",
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


def _by_share(shares: Mapping[str, Share]) -> tuple[str, str]:
    """Ours and the verdict, from the share of flights met by each law; the printed law is `paper`."""
    ours = "; ".join(f"{law}: {one}" for law, one in shares.items())
    cases = {_LAWS[law]: one.low > SURE for law, one in shares.items()}
    return f"flights met, {ours}", verdict(cases, _LAWS["paper"])


def formation_claim(scenario: str, shares: Mapping[str, Share]) -> Claim:
    """All UAVs in formation by the deadline and out of keep-outs, by the share of drawn flights of each law."""
    key, said, number = _FORMATION[scenario]
    return Claim(key, said, number, *_by_share(shares), "tables *The promise …*")


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


def experiment_claim(shares: Mapping[str, Share]) -> Claim:
    """Four quadrotors form up and follow in wind, noise and losses, by the share of drawn flights of each law."""
    ours, found = _by_share(shares)
    return Claim(
        "experiment",
        "Four real quadrotors take up the formation and follow the trajectory",
        "shown in photographs",
        f"simulated: {ours}",
        found,
        "Figs. 33, 34, table *The promise with four and five UAVs*",
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


def saturated_claim(
    shares: Mapping[str, Share], deadline_s: float, limit_n: float, laws: Sequence[str]
) -> Claim:
    """Only ours keeps the deadline with limited actuators: the stated use of the smaller input.

    Args:
        shares: of drawn flights with all UAVs within the tolerance at the deadline, by law.
        deadline_s: the deadline [s].
        limit_n: the largest force of a UAV [N].
        laws: the baselines.
    """
    others = [law for law in laws if shares[law].low > SURE]
    found = _by_case({mine: shares[mine].low > SURE for mine in CASES})
    if others and found != FAILS:
        found += f"; {' and '.join(others)} {'do' if len(others) > 1 else 'does'} too"
    return Claim(
        "limited_actuators",
        "Its inputs suit the limits of real motors better than those of the others",
        "no number",
        f"with {limit_n:.1f} N at most, flights with all UAVs within 0.05 m at {deadline_s:g} s: "
        + "; ".join(f"{law}: {one}" for law, one in shares.items()),
        found,
        "drawn starts (0.3 m per axis), laws tuned as in table *at most*, Fig. A2",
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
