"""A headless flight as the input of a verdict."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core import agent as columns
from ptnsbc_core.types import Array
from ptnsbc_sim.disturbances.faults import gone
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.swarm import HeadlessFlight
from ptnsbc_sim.verdict.recording import COUNTERS, FORMATION, Recording, with_landing
from ptnsbc_sim.verdict.track import Series

_STATUS_HZ = 5
_COUNTED = {
    "avoidance_active_s": columns.ACTIVE_ROWS,
    "saturated_s": columns.SATURATED,
    "holding_s": columns.HOLDING,
    "deadlock_s": columns.DEADLOCK,
}
"""The counters of a time, and the column of the diagnostics that is above 0 during it."""


def recording_of(flight: HeadlessFlight) -> Recording:
    """The input of a verdict from a flight, without a bag."""
    t_ns, track, rows = flight.t_ns, flight.track, list(enumerate(flight.scenario.uav_ids))
    has_truth = bool(len(track.truth))
    every = _chosen(flight.scenario)
    stamps, counted = _counters(flight)
    silent = gone(flight.scenario)  # a UAV whose process is dead sends nothing
    return Recording(
        scenario=flight.scenario,
        odometry={uav: Series(t_ns, track.odometry[:, row]) for row, uav in rows},
        wrench={uav: _sent(silent[:, row], t_ns, track.wrench[:, row]) for row, uav in rows},
        estimate={uav: _sent(silent[:, row], t_ns, track.estimate[:, row]) for row, uav in rows},
        truth={uav: Series(t_ns, track.truth[:, row]) for row, uav in rows if has_truth},
        counters={uav: _sent(silent[every, row], stamps, counted[:, row]) for row, uav in rows},
        epochs=with_landing(flight.scenario, ((int(t_ns[0]), FORMATION),)),
        slots={int(t_ns[0]): flight.slots} if flight.slots else {},
    )


def _sent(silent: NDArray[np.bool_], t_ns: NDArray[np.int64], values: Array) -> Series:
    """Values (T, ...) without those of silent ticks (T,)."""
    return Series(t_ns[~silent], values[~silent]) if silent.any() else Series(t_ns, values)


def _chosen(scenario: Scenario) -> slice:
    """The ticks at which /diagnostics is published."""
    return slice(None, None, max(scenario.timing.control_hz // _STATUS_HZ, 1))


def _counters(flight: HeadlessFlight) -> tuple[NDArray[np.int64], Array]:
    """Stamps (S,) and counters (S, N, 6) as /diagnostics would show them: cumulative, rounded to milliseconds."""
    scenario, log = flight.scenario, flight.track.diagnostics
    chosen = _chosen(scenario)
    stamps = flight.t_ns[chosen]
    ticks = np.cumsum(log[:, :, list(_COUNTED.values())] > 0, axis=0)[chosen]
    values = np.zeros((*ticks.shape[:2], len(COUNTERS)))
    values[:, :, [COUNTERS.index(name) for name in _COUNTED]] = np.round(
        ticks * (scenario.timing.dt_ns * 1e-9), 3
    )
    worst = np.maximum.accumulate(log[:, :, columns.PRIORITY_VIOLATION])[chosen]
    values[:, :, COUNTERS.index("priority_violation_max")] = worst
    return stamps, values
