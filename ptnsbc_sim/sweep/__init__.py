"""Sweeps: many flights of drawn scenarios, and one row of figures for each UAV and flight."""

from ptnsbc_sim.sweep.chunks import fly_chunk
from ptnsbc_sim.sweep.draws import Starts, SweepAxis, parse_axis, parse_starts
from ptnsbc_sim.sweep.plan import SweepError, SweepPlan, draw, drawn_values
from ptnsbc_sim.sweep.runner import FailedChunk, SweepResult, run

__all__ = [
    "SweepAxis",
    "FailedChunk",
    "Starts",
    "SweepError",
    "SweepPlan",
    "SweepResult",
    "draw",
    "drawn_values",
    "fly_chunk",
    "parse_axis",
    "parse_starts",
    "run",
]
