"""A headless flight as the input of a verdict."""

from __future__ import annotations

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_sim import track as columns
from ptnsbc_sim.swarm import HeadlessFlight
from ptnsbc_sim.verdict.recording import COUNTERS, FORMATION, Recording
from ptnsbc_sim.verdict.track import Series

_STATUS_HZ = 5


def recording_of(flight: HeadlessFlight) -> Recording:
    """The input of a verdict from a flight, without a bag."""
    t_ns, track, rows = flight.t_ns, flight.track, list(enumerate(flight.scenario.uav_ids))
    has_truth = bool(len(track.truth))
    return Recording(
        scenario=flight.scenario,
        odometry={uav: Series(t_ns, track.odometry[:, row]) for row, uav in rows},
        wrench={uav: Series(t_ns, track.wrench[:, row]) for row, uav in rows},
        estimate={uav: Series(t_ns, track.estimate[:, row]) for row, uav in rows},
        truth={uav: Series(t_ns, track.truth[:, row]) for row, uav in rows if has_truth},
        counters={uav: _counters(flight, row) for row, uav in rows},
        epochs=((int(t_ns[0]), FORMATION),),
        slots={int(t_ns[0]): flight.slots} if flight.slots else {},
    )


def _counters(flight: HeadlessFlight, row: int) -> Series:
    """The counters of one UAV as /diagnostics would show them: cumulative, rounded to milliseconds."""
    scenario = flight.scenario
    log = flight.track.diagnostics[:, row]
    dt = scenario.dt_ns * 1e-9
    chosen = slice(None, None, max(scenario.control_hz // _STATUS_HZ, 1))
    stamps = flight.t_ns[chosen]

    def seconds(column: int) -> Array:
        return np.round(np.cumsum(log[:, column] > 0)[chosen] * dt, 3)

    values = {
        "avoidance_active_s": seconds(columns.ACTIVE_ROWS),
        "saturated_s": seconds(columns.SATURATED),
        "holding_s": seconds(columns.HOLDING),
        "missed_ticks": np.zeros(stamps.size),
        "priority_violation_max": np.maximum.accumulate(log[:, columns.PRIORITY_VIOLATION])[chosen],
    }
    return Series(stamps, np.stack([values[name] for name in COUNTERS], axis=1))
