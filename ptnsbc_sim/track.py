"""The record of a headless flight, tick by tick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptnsbc_core.agent import store_diagnostics, store_velocity, store_wrench
from ptnsbc_core.algebra import store, store3
from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.kinematics import store_estimate
from ptnsbc_core.types import ODOMETRY_SIZE, AgentOutputs, Array

# Columns of Track.diagnostics
ERROR, GAIN, SINGULAR_VALUE, ACTIVE_ROWS = slice(0, 3), 3, 4, 5
SATURATED, HOLDING, PRIORITY_VIOLATION, VELOCITY_ERROR, DEADLOCK = 6, 7, 8, 9, 10
DIAGNOSTICS_SIZE = 11


class FlightTrack(NamedTuple):
    """The record of a flight, one row per tick; also the buffer that the kernel fills."""

    odometry: Array  # (T, N, 13)
    velocity: Array  # (T, N, 4)
    wrench: Array  # (T, N, 6)
    estimate: Array  # (T, N, 13)
    diagnostics: Array  # (T, N, 11)
    reported: (
        Array  # (T, N, 13) formation_state: the odometry with the velocity that the UAV commands
    )
    truth: Array  # (T, N, 13) where everybody really was; (0, N, 13) when that is what the odometry says


@inline_kernel
def note(track: FlightTrack, tick: int, row: int, out: AgentOutputs) -> None:
    """Write one UAV's outputs of one tick into the track."""
    store_velocity(track.velocity[tick, row], out)
    store_wrench(track.wrench[tick, row], out)
    store_estimate(track.estimate[tick, row], out.estimate, out.estimate_valid)
    store_diagnostics(track.diagnostics[tick, row], out.diagnostics)
    store(track.reported[tick, row], 0, track.odometry[tick, row])
    store3(track.reported[tick, row], 7, out.reported)


@inline_kernel
def note_silence(track: FlightTrack, tick: int, row: int) -> None:
    """Write zeros for a UAV that sends nothing: the track may hold an earlier flight."""
    track.velocity[tick, row] = 0.0
    track.wrench[tick, row] = 0.0
    track.estimate[tick, row] = 0.0
    track.diagnostics[tick, row] = 0.0
    track.reported[tick, row] = 0.0


def track_of(
    ticks: int, size: int, *, with_truth: bool, room: FlightTrack | None = None
) -> FlightTrack:
    """Room for a flight of so many ticks and UAVs: that of an earlier one where it is given and fits."""
    widths = (ODOMETRY_SIZE, 4, 6, ODOMETRY_SIZE, DIAGNOSTICS_SIZE, ODOMETRY_SIZE, ODOMETRY_SIZE)
    lengths = (ticks,) * 6 + (ticks if with_truth else 0,)
    shapes = [(length, size, width) for length, width in zip(lengths, widths, strict=True)]
    if room is not None and [array.shape for array in room] == shapes:
        return room
    return FlightTrack(*(np.zeros(shape) for shape in shapes))
