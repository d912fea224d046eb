"""A headless flight as a Recording, without the way through a bag."""

from __future__ import annotations

import numpy as np

from ptnsbc_sim import track
from ptnsbc_sim.swarm import HeadlessFlight
from ptnsbc_tools.verdict import Recording, Series
from ptnsbc_tools.verdict.recording import COUNTERS

STATUS_HZ = 5


def _counters(flight: HeadlessFlight, row: int) -> Series:
    """What /diagnostics would have told: cumulative, five times a second, in milliseconds."""
    scenario = flight.scenario
    log = flight.track.diagnostics[:, row]
    dt = scenario.dt_ns * 1e-9
    chosen = slice(None, None, max(scenario.control_hz // STATUS_HZ, 1))
    stamps = flight.t_ns[chosen]
    columns = {
        "avoidance_active_s": np.round(np.cumsum(log[:, track.ACTIVE_ROWS] > 0) * dt, 3)[chosen],
        "saturated_s": np.round(np.cumsum(log[:, track.SATURATED] > 0) * dt, 3)[chosen],
        "holding_s": np.round(np.cumsum(log[:, track.HOLDING] > 0) * dt, 3)[chosen],
        "missed_ticks": np.zeros(stamps.size),
        "priority_violation_max": np.maximum.accumulate(log[:, track.PRIORITY_VIOLATION])[chosen],
    }
    return Series(stamps, np.stack([columns[name] for name in COUNTERS], axis=1))


def recording_of(flight: HeadlessFlight) -> Recording:
    """Everything the verdict needs from a flight."""
    track, ids = flight.track, flight.scenario.uav_ids
    return Recording(
        scenario=flight.scenario,
        odometry={uav: Series(flight.t_ns, track.odometry[:, row]) for row, uav in enumerate(ids)},
        wrench={uav: Series(flight.t_ns, track.wrench[:, row]) for row, uav in enumerate(ids)},
        estimate={uav: Series(flight.t_ns, track.estimate[:, row]) for row, uav in enumerate(ids)},
        truth={uav: Series(flight.t_ns, track.truth[:, row]) for row, uav in enumerate(ids)}
        if len(track.truth)
        else {},
        counters={uav: _counters(flight, row) for row, uav in enumerate(ids)},
        epochs=((int(flight.t_ns[0]), "form"),),
    )
