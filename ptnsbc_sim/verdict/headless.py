"""A headless flight as the input of a verdict."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array
from ptnsbc_sim import track as columns
from ptnsbc_sim.disturbances.faults import ends_at
from ptnsbc_sim.swarm import HeadlessFlight
from ptnsbc_sim.verdict.recording import COUNTERS, FORMATION, Recording, with_landing
from ptnsbc_sim.verdict.track import Series

_STATUS_HZ = 5
_COUNTED = {
    "avoidance_active_s": columns.ACTIVE_ROWS,
    "saturated_s": columns.SATURATED,
    "holding_s": columns.HOLDING,
}
"""The counters of a time, and the column of the diagnostics that is above 0 during it."""


def recording_of(flight: HeadlessFlight) -> Recording:
    """The input of a verdict from a flight, without a bag."""
    t_ns, track, rows = flight.t_ns, flight.track, list(enumerate(flight.scenario.uav_ids))
    has_truth = bool(len(track.truth))
    stamps, counted = _counters(flight)
    # A UAV that is killed sends nothing more.
    last_ns = t_ns[np.clip(ends_at(flight.scenario), 1, len(t_ns)) - 1]
    return Recording(
        scenario=flight.scenario,
        odometry={uav: Series(t_ns, track.odometry[:, row]) for row, uav in rows},
        wrench={uav: _until(last_ns[row], t_ns, track.wrench[:, row]) for row, uav in rows},
        estimate={uav: _until(last_ns[row], t_ns, track.estimate[:, row]) for row, uav in rows},
        truth={uav: Series(t_ns, track.truth[:, row]) for row, uav in rows if has_truth},
        counters={uav: _until(last_ns[row], stamps, counted[:, row]) for row, uav in rows},
        epochs=with_landing(flight.scenario, ((int(t_ns[0]), FORMATION),)),
        slots={int(t_ns[0]): flight.slots} if flight.slots else {},
    )


def _until(last_ns: int, t_ns: NDArray[np.int64], values: Array) -> Series:
    """Values (T, ...) up to an instant [ns]."""
    count = int(np.searchsorted(t_ns, last_ns, "right"))
    return Series(t_ns[:count], values[:count])


def _counters(flight: HeadlessFlight) -> tuple[NDArray[np.int64], Array]:
    """Stamps (S,) and counters (S, N, 5) as /diagnostics would show them: cumulative, rounded to milliseconds."""
    scenario, log = flight.scenario, flight.track.diagnostics
    chosen = slice(None, None, max(scenario.control_hz // _STATUS_HZ, 1))
    stamps = flight.t_ns[chosen]
    ticks = np.cumsum(log[:, :, list(_COUNTED.values())] > 0, axis=0)[chosen]
    values = np.zeros((*ticks.shape[:2], len(COUNTERS)))
    values[:, :, [COUNTERS.index(name) for name in _COUNTED]] = np.round(
        ticks * (scenario.dt_ns * 1e-9), 3
    )
    worst = np.maximum.accumulate(log[:, :, columns.PRIORITY_VIOLATION])[chosen]
    values[:, :, COUNTERS.index("priority_violation_max")] = worst
    return stamps, values
