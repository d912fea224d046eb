"""Claims that compare ours with the baselines. Flights by law: `ours, soft`, `ptsmc_exponential`, …"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ptnsbc_tools.reproduce.claims import FAILS, verdict
from ptnsbc_tools.reproduce.experiment_result import Claim
from ptnsbc_tools.reproduce.flights import JudgedFlight

PRINTED = "ours, paper, unfiltered"
CASES = (PRINTED, "ours, paper", "ours, soft")
_WORDS = {
    PRINTED: "printed gains, no command filter",
    "ours, paper": "printed gains behind the command filter",
    "ours, soft": "profile soft",
}
_CONDITIONS = {
    PRINTED: "printed",
    "ours, paper": "the printed gains are flown behind a command filter",
    "ours, soft": "the profile is soft",
}
_FIVE = 5


def initial_reduction(flights: Mapping[str, JudgedFlight], mine: str, law: str) -> float:
    """By how many percent our initial input is below that of a law; negative when above."""
    return 100.0 * (1.0 - flights[mine].initial_input() / flights[law].initial_input())


def compared(flights: Mapping[str, JudgedFlight], mine: str, law: str) -> str:
    """The same in words."""
    found = initial_reduction(flights, mine, law)
    return f"{abs(found):.0f} % {'below' if found >= 0 else 'above'}"


def _least(flights: Mapping[str, JudgedFlight], laws: Sequence[str]) -> dict[str, float]:
    """The smallest reduction against any of the laws, by case of ours."""
    return {mine: min(initial_reduction(flights, mine, law) for law in laws) for mine in CASES}


def _listed(found: Mapping[str, float]) -> str:
    return ", ".join(
        f"{_WORDS[mine]} {abs(value):.0f} % {'lower' if value >= 0 else 'higher'}"
        for mine, value in found.items()
    )


def _verdict(cases: Mapping[str, bool]) -> str:
    named = {_CONDITIONS[mine]: good for mine, good in cases.items()}
    return verdict(named, _CONDITIONS[PRINTED])


def initial_claim(
    key: str,
    flights: Mapping[str, JudgedFlight],
    matched: Mapping[str, JudgedFlight] | None,
    percent: float,
    laws: Sequence[str],
) -> Claim:
    """Initial input at least `percent` below that of predefined-time control without a time base."""
    found = _least(flights, laws)
    newtons = [f"{law} {one.initial_input():.0f}" for law, one in flights.items()]
    told = f"against the gentler of the two: {_listed(found)} (inputs: {', '.join(newtons)})"
    if matched is not None:
        told += f". The baselines tuned to settle when profile soft does: {_listed(_least(matched, laws))}"
    many = len(flights["ours, soft"].scenario.uav_ids) > _FIVE
    return Claim(
        key,
        ("With twenty UAVs the" if many else "The")
        + " initial input is far below that of predefined-time control without a time base",
        f"at least {percent:.0f} %" + ("" if many else "; 300 N for 4000 N and 1500 N"),
        told,
        _verdict({mine: value >= percent for mine, value in found.items()}),
        "table *Twenty UAVs*" if many else "Figs. 19 to 22, A2",
    )


def saturated_claim(
    flights: Mapping[str, JudgedFlight], limit_n: float, laws: Sequence[str]
) -> Claim:
    """Only ours keeps the deadline with real actuators: what the smaller input is said to be good for."""
    deadline_s = flights["ours, soft"].scenario.gains.formation.deadline_s
    within = {law: one.within_at(deadline_s) for law, one in flights.items()}
    size = len(flights["ours, soft"].scenario.uav_ids)
    others = [law for law in laws if within[law] == size]
    found = _verdict({mine: within[mine] == size for mine in CASES})
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


def spent_claim(
    flights: Mapping[str, JudgedFlight], matched: Mapping[str, JudgedFlight], laws: Sequence[str]
) -> Claim:
    """Less energy than predefined-time control without a time base."""
    least = {
        name: min(some[law].energy_beyond_hover() for law in laws)
        for name, some in (("nominal", flights), ("matched", matched))
    }
    spent = {mine: flights[mine].energy_beyond_hover() for mine in CASES}
    told = ", ".join(f"{_WORDS[mine]} {value:.0f} N²s" for mine, value in spent.items())
    return Claim(
        "energy",
        "Energy (54) is a second indicator of a controller; here against the baselines",
        "a figure; no number, nothing compared",
        f"beyond hover: {told}; the better baseline {least['nominal']:.0f} N²s, tuned to settle when ours does "
        f"{least['matched']:.0f} N²s",
        _verdict({mine: value < least["nominal"] for mine, value in spent.items()}),
        "Fig. 23",
    )
