"""Claims of the paper against what was flown. Pure functions: tests call them on short flights."""

from __future__ import annotations

from collections.abc import Mapping

from ptnsbc_tools.reproduce.flights import Flown
from ptnsbc_tools.reproduce.part import Claim

HOLDS, FAILS = "holds", "does not hold"
_PRINTED = "paper"

_FORMATION = {
    "paper_5": ("formation_with_obstacles", "with obstacles on the way", "Figs. 5, 6, 9, 11"),
    "paper_5_free": ("formation_without_obstacles", "without obstacles", "Figs. 7, 8, 10, 12"),
}


def verdict(by_case: Mapping[str, bool], printed: str = _PRINTED) -> str:
    """`holds` when it does as printed, `holds when` with the cases in which it does, or not."""
    good = [case for case, holds in by_case.items() if holds]
    if by_case.get(printed):
        return HOLDS
    return f"holds when {' or '.join(good)}" if good else FAILS


def kept(flown: Flown) -> bool:
    """Deadline met by all UAVs, and nothing touched."""
    return flown.met() == len(flown.verdict.uavs) and flown.clearance_m() >= 0.0


def formation_claim(scenario: str, flights: Mapping[str, Flown]) -> Claim:
    """All UAVs in formation within the deadline, for each profile."""
    key, where, figures = _FORMATION[scenario]
    told = [
        f"{profile}: {one.met()} of {len(one.verdict.uavs)} UAVs, error at 5 s at most "
        f"{one.worst_at_deadline_m():.3f} m"
        for profile, one in flights.items()
    ]
    cases = {f"profile {profile}": kept(one) for profile, one in flights.items()}
    return Claim(
        key,
        f"All five UAVs are in formation within the time chosen beforehand, {where}",
        "5 s",
        "; ".join(told),
        verdict(cases, f"profile {_PRINTED}"),
        figures,
    )
