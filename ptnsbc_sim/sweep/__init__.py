"""Sweeps: many flights of drawn scenarios, and one row of figures for each UAV and flight."""

from ptnsbc_sim.sweep.draws import Starts, SweepAxis, SweepError, parse_axis, parse_starts
from ptnsbc_sim.sweep.plan import SweepPlan, draw, drawn_values
from ptnsbc_sim.sweep.runner import FailedChunk, SweepResult, fly_chunk, run

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
