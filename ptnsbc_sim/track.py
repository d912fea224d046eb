"""The record of a headless flight, tick by tick."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ptnsbc_core.agent import DIAGNOSTICS_SIZE, store_outputs
from ptnsbc_core.algebra import store
from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.types import ODOMETRY_SIZE, AgentOutputs, Array
from ptnsbc_sim.scenario.problems import ScenarioError

if TYPE_CHECKING:
    from ptnsbc_sim.scenario import Scenario

_WIDTHS = (ODOMETRY_SIZE, 4, 6, ODOMETRY_SIZE, DIAGNOSTICS_SIZE, ODOMETRY_SIZE, ODOMETRY_SIZE)
_NUMBER_BYTES = 8


class FlightTrack(NamedTuple):
    """The record of a flight, one row per tick; also the buffer that the kernel fills."""

    odometry: Array  # (T, N, 13)
    velocity: Array  # (T, N, 4)
    wrench: Array  # (T, N, 6)
    estimate: Array  # (T, N, 13)
    diagnostics: Array  # (T, N, 11)
    reported: Array  # (T, N, 13) formation_state: odometry, the velocity is what the UAV commands
    truth: Array  # (T, N, 13) where everybody really was; (0, N, 13) when that is what the odometry says


@inline_kernel
def note(track: FlightTrack, tick: int, row: int, out: AgentOutputs) -> None:
    """Write one UAV's outputs of one tick into the track."""
    reported = track.reported[tick, row]
    store(reported, 0, track.odometry[tick, row])
    store_outputs(
        out,
        track.velocity[tick, row],
        track.wrench[tick, row],
        track.estimate[tick, row],
        reported[7:10],
        track.diagnostics[tick, row],
    )


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
    lengths = (ticks,) * 6 + (ticks if with_truth else 0,)
    shapes = [(length, size, width) for length, width in zip(lengths, _WIDTHS, strict=True)]
    if room is not None and [array.shape for array in room] == shapes:
        return room
    return FlightTrack(*(np.zeros(shape) for shape in shapes))


def refuse_without_memory(scenario: Scenario) -> None:
    """Raise ScenarioError, before anything is allocated, for a flight whose record does not fit into free memory."""
    count, free = len(scenario.uav_ids), _free_bytes()
    widths = _WIDTHS if scenario.imperfect else _WIDTHS[:-1]
    second = scenario.timing.control_hz * count * sum(widths) * _NUMBER_BYTES
    needed = scenario.timing.duration_s * second
    if needed > free:
        raise ScenarioError(
            f"{scenario.source}: timing.duration_s: {scenario.timing.duration_s:g} s of {count} UAVs at "
            f"{scenario.timing.control_hz} Hz take {needed * 1e-9:.3g} GB of memory: expected at most "
            f"{free * 1e-9:.3g} GB, which are free: shorten timing.duration_s "
            f"to at most {free // second:.0f} s, or lower timing.control_hz"
        )


def _free_bytes() -> float:
    """Memory that a process can still have, of this computer; no limit where the system does not say it."""
    try:
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
    except OSError:
        return float("inf")
    sizes = dict(line.split(":", 1) for line in lines)
    return 1024.0 * int(sizes["MemAvailable"].split()[0])
