"""Recordings whose positions are known in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.types import Array
from ptnsbc_sim.counters import COUNTERS
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.verdict import Recording, Track, Verdict

Errors = Callable[[Array], Array]
HZ = 100


def counters(
    seconds: float, active: Callable[[Array], Array] = np.zeros_like, **values: Any
) -> Track:
    """Counters at 5 Hz; `active` gives avoidance_active_s over time."""
    t = np.arange(0.0, seconds, 0.2)
    columns = {name: np.zeros(t.size) for name in COUNTERS} | {"avoidance_active_s": active(t)}
    columns |= {name: np.full(t.size, value) for name, value in values.items()}
    rows = np.stack([columns[name] for name in COUNTERS], axis=1)
    return Track(np.round(t * 1e9).astype(np.int64), rows)


def flight(
    errors: dict[int, Errors] | None = None,
    *,
    seconds: float = 12.0,
    scenario: Scenario | None = None,
    **changes: Any,
) -> Recording:
    """A flight of paper_5_free in which UAV i is errors[i](t) metres east of its place."""
    scenario = scenario or load_scenario("paper_5_free", {"timing.duration_s": seconds})
    t_ns = np.arange(round(seconds * HZ), dtype=np.int64) * (10**9 // HZ)
    t = t_ns * 1e-9
    vector = leader_trajectory(scenario)
    path = np.stack([reference(vector, float(one)).position for one in t])
    odometry, wrench = {}, {}
    leader_error = (errors or {}).get(scenario.leader.id, np.zeros_like)(t)
    for uav in scenario.uav_ids:
        vectors = np.zeros((t.size, 13))
        vectors[:, 6] = 1.0
        vectors[:, :3] = path + scenario.offset(uav)
        vectors[:, 0] += leader_error
        if uav != scenario.leader.id:
            vectors[:, 0] += (errors or {}).get(uav, np.zeros_like)(t)
        odometry[uav] = Track(t_ns, vectors)
        forces = np.zeros((t.size, 6))
        forces[:, 2] = scenario.plant.mass_kg * scenario.world.gravity_m_s2
        wrench[uav] = Track(t_ns, forces)
    made = Recording(
        scenario,
        odometry,
        wrench,
        {},
        {uav: counters(seconds) for uav in scenario.uav_ids},
        ((0, "form"),),
    )
    return replace(made, **changes)


def thinned(series: Track, *ticks: int) -> Track:
    """A series without the messages of some ticks."""
    return Track(np.delete(series.t_ns, ticks), np.delete(series.values, ticks, axis=0))


def decay(start: float, rate: float) -> Errors:
    """An error that decays from `start` [m] at `rate` [1/s]."""
    return lambda t: start * np.exp(-rate * t)


def away(begin: float, back: float) -> Errors:
    """Half a metre off from `begin` to `back` [s]."""
    return lambda t: np.where((t > begin) & (t < back), 0.5, 0.0)


def verdict_of(verdict: Verdict, uav: int) -> Any:
    """What a verdict says of one UAV."""
    return next(one for one in verdict.uavs if one.uav == uav)
