"""Pre-flight check of UAVs that come and go: whether what the scenario plans for them can come about."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.behaviours.recovery import recovery_duration
from ptnsbc_core.curves.trajectory import reference
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.build import leader_trajectory, places_beside_leader, recovery_config
from ptnsbc_sim.scenario.mission.faults import PROCESS, modelled
from ptnsbc_sim.scenario.mission.membership import (
    NEVER_NS,
    Formations,
    Membership,
    joins_ns,
    leaves_ns,
)
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, Finding, Findings


def membership(scenario: Scenario) -> Findings:
    """The times of joining and leaving, who leads at which time, and what becomes of empty slots."""
    if not scenario.formation.reconfigures:
        return
    yield from _times(scenario)
    yield from _lead(scenario)
    if scenario.formation.vacancy == "close_up" and max(scenario.topology.depth.values()) < 2:
        yield Finding(
            WARNING,
            "formation.vacancy",
            "close_up, and no UAV of communication.tree is behind a follower",
            "a tree with lines, along which UAVs move up",
            "set keep, which does the same here, or let followers have parents among them",
        )


def _times(scenario: Scenario) -> Findings:
    """The times of the UAVs against the length of the flight."""
    end_s = scenario.timing.duration_s
    for index, uav in enumerate(scenario.uavs):
        for key, at_s, verb in (
            ("joins_s", uav.joins_s, "joins"),
            ("leaves_s", uav.leaves_s, "leaves"),
        ):
            if at_s is not None and at_s >= end_s:
                yield Finding(
                    WARNING,
                    f"uavs[{index}].{key}",
                    f"{at_s:g} s: UAV {uav.id} never {verb}",
                    f"< timing.duration_s, {end_s:g} s",
                    f"lower {key}, or fly longer",
                )
        if uav.joins_s is not None and uav.joins_s < end_s:
            yield _joined(scenario, index, uav.joins_s)


def _joined(scenario: Scenario, index: int, joins_s: float) -> Finding:
    """The time that a UAV which joins needs to its place, at the limits of its way back."""
    uav = scenario.uavs[index].id
    leader = np.array(reference(leader_trajectory(scenario), joins_s).position)
    place = leader + places_beside_leader(scenario, uav, np.array([joins_s]))[0]
    away_m = float(np.linalg.norm(place - scenario.uav(uav).position))
    needed_s = joins_s + recovery_duration(away_m, recovery_config(scenario, uav))
    leaves_s = scenario.uavs[index].leaves_s
    until_s = min(
        scenario.timing.duration_s, scenario.timing.duration_s if leaves_s is None else leaves_s
    )
    late = needed_s > until_s
    return Finding(
        WARNING if late else INFO,
        f"uavs[{index}].joins_s",
        f"{joins_s:g} s: UAV {uav} is {away_m:.2f} m from its place then, and needs until {needed_s:.2f} s",
        f"<= {until_s:g} s, when the flight ends or the UAV leaves",
        "join earlier or nearer, or fly longer" if late else "",
    )


def _lead(scenario: Scenario) -> Findings:
    """The leaders, by the plan and by the faults that end processes; what is lost unforeseen is not known here."""
    formations, line = Formations(scenario), scenario.leader.successors
    free_s = None  # from when the first leader is away
    away: set[int] = set()
    for at_s in _changes_s(scenario):
        absent = _absent(scenario, at_s, killed=True)
        away |= absent
        leader_away = scenario.leader.id in absent
        if free_s is None and leader_away:
            free_s = at_s
            yield from _idle_successors(scenario, at_s, absent, away)
        if formations.of(Membership(frozenset(absent), frozenset(away - absent))) is None:
            planned = not {scenario.leader.id, *line} - _absent(scenario, at_s, killed=False)
            yield Finding(
                ERROR if planned else WARNING,
                "leader.successors",
                f"[{', '.join(map(str, line))}]: from {at_s:g} s on nobody leads: all hold",
                "a successor that is there then",
                "name one, or let the leader or a successor stay",
            )
            return


def _idle_successors(scenario: Scenario, at_s: float, absent: set[int], away: set[int]) -> Findings:
    """The successors that cannot take over when the leader is away."""
    for index, uav in enumerate(scenario.leader.successors):
        if uav in away:
            why = "is away then" if uav in absent else "was away before"
            yield Finding(
                WARNING,
                f"leader.successors[{index}]",
                f"UAV {uav} {why}, when the lead is free at {at_s:g} s",
                "a UAV that is there from the begin on until then",
                "name another one, or let it stay",
            )


def _changes_s(scenario: Scenario) -> list[float]:
    """The times within the flight at which somebody comes or goes."""
    spans = [span for uav in scenario.uav_ids for span in _gone_ns(scenario, uav, killed=True)]
    found = {at_ns * 1e-9 for span in spans for at_ns in span}
    return sorted(at_s for at_s in found if 0.0 <= at_s < scenario.timing.duration_s)


def _absent(scenario: Scenario, at_s: float, *, killed: bool) -> set[int]:
    at_ns = round(at_s * 1e9)
    return {
        uav
        for uav in scenario.uav_ids
        if any(since <= at_ns < until for since, until in _gone_ns(scenario, uav, killed=killed))
    }


def _gone_ns(scenario: Scenario, uav: int, *, killed: bool) -> list[tuple[int, int]]:
    """The spans [ns] in which a UAV is away; `killed`: also those of faults that end its process."""
    found = [(0, joins_ns(scenario, uav)), (leaves_ns(scenario, uav), NEVER_NS)]
    stale_ns = round(float(scenario.communication.stale_s) * 1e9)
    for fault in modelled(scenario.faults) if killed else ():
        if fault.rule.strikes == PROCESS and fault.struck_uav == uav:
            since, until = fault.window_ns(0)
            found.append((since + stale_ns, until))
    return [(since, until) for since, until in found if since < until]
