"""The distances of UAVs to each other and to obstacles, and the keep-outs that they entered.

A keep-out is entered where a distance is below it at a judged instant: between centres, and from the surface of an
obstacle that is no sphere. The distance is compared as it is:
there is no slack for rounding, and none for errors of the positions.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ptnsbc_core.types import Array
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


class _Pair:
    """The closest approach of one pair, whose distances arrive block by block."""

    def __init__(self, names: tuple[str, str], keep_out: float) -> None:
        self._names = names
        self._keep_out = keep_out
        self._closest = np.inf
        self._at_s: float | None = None
        self._inside_s = 0.0
        self._inside_since: float | None = None  # of the newest sample, when it is inside

    def add(self, times: Array, periods: Array, distance: Array) -> None:
        """Take the next distances (T,) [m] at (T,) [s], each of which lasts for its period (T,) [s]."""
        closest = int(np.argmin(distance))  # the first NaN, if there is one
        if not np.isfinite(distance[closest]):  # NaN is neither near nor far
            distance = np.where(np.isfinite(distance), distance, np.inf)
            closest = int(np.argmin(distance))
        if self._at_s is None or distance[closest] < self._closest:
            self._closest, self._at_s = float(distance[closest]), float(times[closest])
        since, self._inside_since = self._inside_since, None
        if distance[closest] < self._keep_out:
            inside = distance < self._keep_out
            self._inside_s += float(np.sum(periods[inside]))
            self._inside_since = float(times[-1]) if inside[-1] else None
        if since is not None:
            self._inside_s += float(times[0] - since)

    def separation(self) -> Separation:
        """The closest approach so far."""
        at_s = self._at_s or 0.0
        return Separation(*self._names, self._closest, at_s, self._keep_out, self._inside_s)


class Separations:
    """Closest approach of every pair of UAVs and of every UAV and obstacle."""

    def __init__(self, recording: Recording) -> None:
        scenario = recording.scenario
        self._first_ns = recording.first_ns
        self._pairs = {
            (a, b): _Pair((f"uav{a}", f"uav{b}"), scenario.keep_out_between(a, b))
            for a, b in combinations(scenario.uav_ids, 2)
        }
        self._obstacles = [
            (uav, one, _Pair((f"uav{uav}", one.name), one.keep_out_m))
            for uav in scenario.uav_ids
            for one in scenario.world.bodies
        ]

    def add(self, block: Instants) -> None:
        """Take the next instants."""
        times, positions = seconds_since(block.stamps, self._first_ns), block.positions
        periods = np.diff(times, append=times[-1])
        for (a, b), pair in self._pairs.items():
            pair.add(times, periods, lengths(positions[a] - positions[b]))
        for uav, obstacle, pair in self._obstacles:
            pair.add(times, periods, obstacle.distances(positions[uav], times))

    def results(self) -> list[Separation]:
        """All pairs, the smallest margin first."""
        pairs = [*self._pairs.values(), *(pair for _, _, pair in self._obstacles)]
        return sorted((pair.separation() for pair in pairs), key=_room)


def _room(pair: Separation) -> float:
    return pair.distance_m - pair.keep_out_m


def joined(parts: Iterable[Iterable[Separation]]) -> list[Separation]:
    """The separations of several spans as those of one."""
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
