"""The distances of UAVs to each other and to obstacles, and the keep-outs that they entered.

A keep-out is entered where a distance is below it at a judged instant: between centres, and from the surface of an
obstacle that is no sphere. The distance is compared as it is:
there is no slack for rounding, and none for errors of the positions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.verdict.recording import Instants, Recording, seconds_since
from ptnsbc_sim.verdict.track import lengths


@dataclass(frozen=True)
class Separation:
    """The closest approach of two UAVs, or of a UAV and an obstacle."""

    first: str
    second: str
    distance_m: float
    at_s: float  # after the first epoch
    keep_out_m: float
    inside_s: float  # time closer than keep_out_m

    @property
    def entered(self) -> bool:
        """True if the distance was below the keep-out."""
        return self.distance_m < self.keep_out_m


def distances(
    scenario: Scenario, positions: Mapping[int, Array], times: Array
) -> Iterator[tuple[str, str, float, Array]]:
    """Names, keep-out [m] and distances (T,) [m] of every pair of UAVs, and of every UAV and obstacle.

    `positions` are (T, 3) [m], `times` (T,) [s] after the first epoch.
    """
    for a, b in combinations(scenario.uav_ids, 2):
        keep_out_m = scenario.keep_out_between(a, b)
        yield f"uav{a}", f"uav{b}", keep_out_m, lengths(positions[a] - positions[b])
    for uav, body in product(scenario.uav_ids, scenario.world.bodies):
        yield f"uav{uav}", body.name, body.keep_out_m, body.distances(positions[uav], times)


def separations(recording: Recording, block: Instants) -> list[Separation]:
    """The closest approaches in a block of instants, each of which lasts until the next one."""
    times = seconds_since(block.stamps, recording.first_ns)
    lasting = np.diff(times, append=seconds(block.until_ns - recording.first_ns))
    closest = []
    for first, second, keep_out_m, distance in distances(
        recording.scenario, block.positions, times
    ):
        k = int(np.argmin(distance))  # the first NaN, if there is one
        if not np.isfinite(distance[k]):  # NaN is neither near nor far
            distance = np.where(np.isfinite(distance), distance, np.inf)
            k = int(np.argmin(distance))
        inside_s = float(np.sum(lasting[distance < keep_out_m]))
        about = float(distance[k]), float(times[k]), keep_out_m, inside_s
        closest.append(Separation(first, second, *about))
    return closest


def _room(pair: Separation) -> float:
    return pair.distance_m - pair.keep_out_m


def joined(parts: Iterable[Iterable[Separation]]) -> list[Separation]:
    """The separations of several spans as those of one, the smallest margin first."""
    found: dict[tuple[str, str], Separation] = {}
    for part in parts:
        for pair in part:
            key = pair.first, pair.second
            before = found.get(key)
            if before is not None:
                nearer = min(before, pair, key=lambda one: one.distance_m)
                pair = replace(nearer, inside_s=before.inside_s + pair.inside_s)
            found[key] = pair
    return sorted(found.values(), key=_room)


def intrusion(separations: Iterable[Separation], uav: int) -> str:
    """The keep-outs that a UAV entered, the deepest in numbers; empty when it entered none."""
    name = f"uav{uav}"
    entered = [one for one in separations if one.entered and name in (one.first, one.second)]
    if not entered:
        return ""
    deepest = min(entered, key=_room)
    other = deepest.second if deepest.first == name else deepest.first
    text = (
        f"{deepest.distance_m:.3f} m from {other} at {deepest.at_s:.2f} s, inside the keep-out of "
        f"{deepest.keep_out_m:g} m for {deepest.inside_s:.2f} s"
    )
    more = len(entered) - 1
    return text if not more else f"{text}, and inside {more} more"
