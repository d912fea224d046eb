"""Claims of the paper against what was flown. Pure functions: tests call them on short flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ptnsbc_tools.reproduce.experiment_result import Claim
from ptnsbc_tools.reproduce.flights import JudgedFlight

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


def kept(flown: JudgedFlight) -> bool:
    """Deadline met by all UAVs, and nothing touched."""
    return flown.met() == len(flown.verdict.uavs) and flown.clearance_m() >= 0.0


def formation_claim(scenario: str, flights: Mapping[str, JudgedFlight]) -> Claim:
    """All UAVs in formation within the deadline, for each profile."""
    key, where, figures = _FORMATION[scenario]
    told = [
        f"{profile}: {one.met()} of {len(one.verdict.uavs)} UAVs, error at 5 s at most "
        f"{one.worst_at_deadline_m():.3f} m"
        for profile, one in flights.items()
    ]
    cases = {f"the profile is {profile}": kept(one) for profile, one in flights.items()}
    return Claim(
        key,
        f"All five UAVs are in formation within the time chosen beforehand, {where}",
        "5 s",
        "; ".join(told),
        verdict(cases, f"the profile is {_PRINTED}"),
        figures,
    )


def velocity_claim(flights: Mapping[str, JudgedFlight]) -> Claim:
    """The velocity error stays within the sliding boundary from tf3 on."""
    some = next(iter(flights.values())).scenario.gains
    deadline_s, width = some.force.deadline_s, some.boundary.velocity_m_s
    worst = {profile: one.velocity_error_after(deadline_s) for profile, one in flights.items()}
    told = [f"{profile}: {value:.3f} m/s at most" for profile, value in worst.items()]
    cases = {f"the profile is {profile}": value <= width for profile, value in worst.items()}
    return Claim(
        "velocity_error",
        "The controller brings the velocity to its command within a time chosen beforehand",
        "into a neighbourhood of zero, (A.11)",
        f"after tf3 = {deadline_s:g} s, width of the sliding boundary {width:g} m/s: "
        + "; ".join(told),
        verdict(cases, f"the profile is {_PRINTED}"),
        "table *Every flight of Simulation 1*",
    )


def shape_claim(flights: Mapping[str, JudgedFlight]) -> Claim:
    """Twenty UAVs in formation by the deadline, past the obstacles."""
    told = [
        f"{profile}: {one.met()} of {len(one.verdict.uavs)} UAVs, room beyond keep-outs at least "
        f"{one.clearance_m():.3f} m"
        for profile, one in flights.items()
    ]
    cases = {f"the profile is {profile}": kept(one) for profile, one in flights.items()}
    return Claim(
        "twenty_formation",
        "Twenty UAVs take up a fixed formation, follow the trajectory and avoid the obstacles",
        "20 UAVs",
        "; ".join(told),
        verdict(cases, f"the profile is {_PRINTED}"),
        "Figs. 24, 25, 26",
    )


def limit_claim(flights: Mapping[str, JudgedFlight], limit_n: float) -> Claim:
    """No input of any UAV above a limit; the first of the flights is the printed law."""
    told = [f"{profile}: {one.peak_input():.1f} at most" for profile, one in flights.items()]
    cases = {
        f"the profile is {profile}": one.peak_input() < limit_n for profile, one in flights.items()
    }
    printed = next(iter(cases))
    return Claim(
        "twenty_inputs",
        "With twenty UAVs every input stays below a limit",
        f"{limit_n:.0f} N",
        "; ".join(told),
        verdict(cases, printed),
        "Figs. 27 to 31",
    )


def experiment_claim(
    flights: Sequence[JudgedFlight], fresh: Sequence[JudgedFlight], calm: JudgedFlight
) -> Claim:
    """Four quadrotors form up and follow in every draw of what chance does to them, and without it.

    Args:
        flights: draws on which gains were chosen.
        fresh: draws on which none was.
        calm: nothing left to chance.
    """
    everything = [*flights, *fresh]
    good, unseen = sum(kept(one) for one in everything), sum(kept(one) for one in fresh)
    worst = max(one.worst_at_deadline_m() for one in everything)
    if good == len(everything):
        found = HOLDS
    else:
        found = f"holds when lucky: {good} of {len(everything)} draws" if good else FAILS
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
