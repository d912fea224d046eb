"""The distances of UAVs to each other and to obstacles, and the keep-outs that they entered.

A keep-out is entered where a distance is below it at a judged instant: between centres, and from the surface of an
obstacle that is no sphere. The distance is compared as it is:
there is no slack for rounding, and none for errors of the positions. Of two UAVs whose keep-outs are ellipsoids the
height of one over the other counts less, by `keep_out_scale`: the distance is that of two as near side by side.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

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
    scenario: Scenario, positions: Array, times: Array
) -> Iterator[tuple[str, Sequence[str], Array, Array]]:
    """Names of a UAV and K others, or all obstacles, keep-outs (K,) [m] and distances (K, T) [m]; every pair once.

    `positions` are (3, N, T) [m], `times` (T,) [s] after the first epoch.
    """
    ids, bodies = scenario.uav_ids, scenario.world.bodies
    names = [f"uav{uav}" for uav in ids]
    own = np.array([scenario.keep_out_m(uav) for uav in ids])
    scaled = positions * scenario.formation.keep_out_scale[:, None, None]
    for row, name in enumerate(names[:-1]):
        apart = lengths(scaled[:, row, None] - scaled[:, row + 1 :])
        yield name, names[row + 1 :], 0.5 * (own[row] + own[row + 1 :]), apart
    for row, name in enumerate(names if bodies else ()):
        place = np.ascontiguousarray(positions[:, row].T)
        apart = np.stack([body.distances(place, times) for body in bodies])
        keep_outs = np.array([body.keep_out_m for body in bodies])
        yield name, [body.name for body in bodies], keep_outs, apart


def separations(recording: Recording, block: Instants) -> list[Separation]:
    """The closest approaches in a block of instants, each of which lasts until the next one."""
    times = seconds_since(block.stamps, recording.first_ns)
    until_s = seconds(block.until_ns - recording.first_ns)
    closest = []
    for uav, others, keep_outs, apart in distances(recording.scenario, block.positions, times):
        rows, at = np.arange(len(apart)), apart.argmin(axis=1)  # the first NaN, if there is one
        least = apart[rows, at]
        if not np.isfinite(least).all():  # NaN is neither near nor far
            apart = np.where(np.isfinite(apart), apart, np.inf)
            at = apart.argmin(axis=1)
            least = apart[rows, at]
        at_s = times[at].tolist()
        pairs = zip(others, keep_outs.tolist(), least.tolist(), strict=True)
        for k, (other, keep_out_m, distance_m) in enumerate(pairs):
            inside_s = 0.0
            if distance_m < keep_out_m:
                inside_s = float(np.diff(times, append=until_s)[apart[k] < keep_out_m].sum())
            closest.append(Separation(uav, other, distance_m, at_s[k], keep_out_m, inside_s))
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


def intrusion(entered: Iterable[Separation], uav: int) -> str:
    """The keep-outs that a UAV entered, out of all that were, the deepest in numbers; empty when it entered none."""
    name = f"uav{uav}"
    entered = [pair for pair in entered if name in (pair.first, pair.second)]
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
