"""Figures beside the verdict: input, energy (54), separations, estimator, timing."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array
from ptnsbc_tools.verdict.coverage import coverage
from ptnsbc_tools.verdict.recording import NANO, Recording, Series


@dataclass(frozen=True)
class Effort:
    """What one UAV asked of its actuators."""

    uav: int
    initial_input: float  # |(force, torque)| at the epoch [N, N m]
    initial_above_hover_n: float  # force at the epoch, less the weight
    peak_input: float  # largest |(force, torque)|
    peak_force_n: float
    peak_at_s: float
    energy: float  # integral of |u|^2 (54) [N^2 s]
    energy_above_hover: float  # the same of the force beyond the weight, and the torque
    missing: int  # wrench messages, of one per odometry sent or per control period


@dataclass(frozen=True)
class Separation:
    """The closest approach of one pair."""

    first: str
    second: str
    distance_m: float
    at_s: float
    keep_out_m: float
    inside_s: float  # time closer than keep_out_m


@dataclass(frozen=True)
class EstimatorError:
    """How well one follower knows the leader's position."""

    uav: int
    at_deadline_m: float | None
    max_after_m: float | None


def _held(recording: Recording, series: Series) -> tuple[Array, Array]:
    """Inputs (K, 6) that acted in the judged time, and for how long (K,) [s] each.

    An input is held until the next one is recorded, the last one until the end: a message that is
    missing must not take its time out of an integral.
    """
    start_ns, end_ns = recording.start_ns, recording.end_ns
    at_epoch = max(int(np.searchsorted(series.t_ns, start_ns, side="right")) - 1, 0)
    acted = slice(at_epoch, int(np.searchsorted(series.t_ns, end_ns, side="right")))
    edges = np.clip(np.append(series.t_ns[acted], end_ns), start_ns, end_ns)
    return series.values[acted], np.diff(edges) * NANO


def effort(recording: Recording, uav: int) -> Effort | None:
    """Input figures of one UAV; None when its wrench was not recorded."""
    series = recording.wrench.get(uav)
    if series is None:
        return None
    chosen = (series.t_ns >= recording.start_ns) & (series.t_ns <= recording.end_ns)
    if not chosen.any():
        return None
    times = recording.times(series.t_ns[chosen])
    force, torque = _norms(series.values[chosen])
    whole = np.hypot(force, torque)
    weight = recording.scenario.mass_kg * recording.scenario.gravity_m_s2
    peak = int(np.argmax(whole))
    held, seconds = _held(recording, series)
    held_force, held_torque = _norms(held)
    return Effort(
        uav=uav,
        initial_input=float(whole[0]),
        initial_above_hover_n=float(force[0] - weight),
        peak_input=float(whole[peak]),
        peak_force_n=float(force.max()),
        peak_at_s=float(times[peak]),
        energy=float(np.sum((held_force**2 + held_torque**2) * seconds)),
        energy_above_hover=float(np.sum(((held_force - weight) ** 2 + held_torque**2) * seconds)),
        missing=coverage(recording, uav, series).missing,
    )


def _norms(wrench: Array) -> tuple[Array, Array]:
    """|force| [N] and |torque| [N m], (T,) each."""
    return np.linalg.norm(wrench[:, :3], axis=1), np.linalg.norm(wrench[:, 3:], axis=1)


def _separation(
    names: tuple[str, str], distance: Array, keep_out: float, times: Array
) -> Separation:
    distance = np.where(np.isfinite(distance), distance, np.inf)  # NaN is neither near nor far
    closest = int(np.argmin(distance))
    period = np.diff(times, append=times[-1])
    return Separation(
        names[0],
        names[1],
        float(distance[closest]),
        float(times[closest]),
        keep_out,
        float(np.sum(period[distance < keep_out])),
    )


def separations(
    recording: Recording, grid: NDArray[np.int64], positions: dict[int, Array]
) -> list[Separation]:
    """Closest approach of every pair of UAVs and of every UAV and obstacle, worst margin first."""
    scenario = recording.scenario
    times = recording.times(grid)
    found = []
    for a, b in combinations(scenario.uav_ids, 2):
        distance = np.linalg.norm(positions[a] - positions[b], axis=1)
        names = (f"uav{a}", f"uav{b}")
        found.append(_separation(names, distance, scenario.uav_keep_out_m, times))
    for uav in scenario.uav_ids:
        for obstacle in scenario.obstacles:
            distance = np.linalg.norm(positions[uav] - obstacle.position, axis=1)
            names = (f"uav{uav}", obstacle.name)
            found.append(_separation(names, distance, obstacle.keep_out_m, times))
    return sorted(found, key=lambda pair: pair.distance_m - pair.keep_out_m)


def estimator_error(
    recording: Recording, grid: NDArray[np.int64], leader: Array, uav: int
) -> EstimatorError | None:
    """Error of one follower's leader estimate; None when it was not recorded."""
    series = recording.estimate.get(uav)
    if series is None:
        return None
    times = recording.times(grid)
    deadline = recording.scenario.gains.estimator.deadline_s
    error = np.linalg.norm(series.at(grid)[:, :3] - leader, axis=1)
    after = error[times >= deadline]
    return EstimatorError(
        uav,
        float(np.interp(deadline, times, error)) if times[-1] >= deadline else None,
        float(after.max()) if after.size else None,
    )
