"""Pre-flight check of the ways to the slots: whether the planned paths to them keep their distance."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.approach.deadline import planned_pairs, turn_of
from ptnsbc_sim.scenario.approach.turn import distances
from ptnsbc_sim.scenario.slots import are_open, with_slots_of_starts
from ptnsbc_tools.check.finding import INFO, WARNING, Finding, Findings


def least_distance(first: Array, last: Array) -> float:
    """Least length [m] of a vector (3,) that goes straight from `first` to `last`."""
    way = last - first
    length = float(way @ way)
    share = min(max(-float(first @ way) / length, 0.0), 1.0) if length > 0.0 else 0.0
    return float(np.linalg.norm(first + share * way))


def slots(scenario: Scenario) -> Findings:
    """Distances on the way to open slots, and what they rest on (docs/method.md, Slots)."""
    if not are_open(scenario) or len(scenario.uav_ids) < 2:
        return
    held = with_slots_of_starts(scenario)
    pairs = list(combinations(scenario.uav_ids, 2))
    start = {uav: scenario.uav(uav).position for uav in scenario.uav_ids}
    first = {(a, b): start[a] - start[b] for a, b in pairs}
    last = {(a, b): held.offset(a) - held.offset(b) for a, b in pairs}
    ends = [min(float(np.linalg.norm(one)) for one in end.values()) for end in (first, last)]
    needed = math.sqrt(2.0) * scenario.widest_keep_out_m
    yield Finding(
        INFO if min(ends) >= needed else WARNING,
        "formation.assignment",
        f"starts {ends[0]:.2f} m apart or more, slots {ends[1]:.2f} m",
        f">= {needed:.2f} m, which keeps all paths {scenario.widest_keep_out_m:g} m apart",
        "" if min(ends) >= needed else "start farther apart, or widen the formation",
    )
    paths = {pair: least_distance(first[pair], last[pair]) for pair in pairs}
    a, b = min(pairs, key=lambda pair: paths[pair])
    near = paths[a, b] < scenario.widest_keep_out_m
    yield Finding(
        WARNING if near else INFO,
        "formation.assignment",
        f"UAV {a} and UAV {b} come as close as {paths[a, b]:.2f} m on their ways",
        f">= {scenario.widest_keep_out_m:g} m",
        "start farther apart, or widen the formation" if near else "",
    )
    if scenario.formation.approach == "task":
        yield Finding(
            WARNING,
            "formation.approach",
            "task",
            "planned, where slots are open",
            "the paths of a task are not straight and keep no distance",
        )


def turn(scenario: Scenario) -> Findings:
    """The turn of the planned approach, and the distance that it keeps (docs/method.md, Turned approach)."""
    angle = turn_of(scenario)
    if angle == 0.0:
        return
    pairs = planned_pairs(scenario)
    straight, turned = (float(distances(pairs, one).min()) for one in (0.0, angle))
    near = turned < scenario.widest_keep_out_m
    yield Finding(
        WARNING if near else INFO,
        "formation.turn_rad",
        f"{angle:.2f}: planned paths come as close as {turned:.2f} m, straight ones {straight:.2f} m",
        f">= {scenario.widest_keep_out_m:g} m",
        "leave formation.turn_rad out" if near else "",
    )
