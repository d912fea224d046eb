"""Tables of flights that nobody flew."""

from __future__ import annotations

from dataclasses import replace

from ptnsbc_sim.sweep.rows import SweepRow
from ptnsbc_tools.sweeps.summary import FlightTable, table_of

ROW = SweepRow(
    draw=0, uav=1, slot=1, verdict="met", cause="", flight_verdict="met", deadline_s=5.0, start_error_m=1.0,
    tolerance_m=0.05, band_m=0.05, settling_s=4.0, error_at_deadline_m=0.01, in_place=True,
    arrived_s=None, gave_way_to="", largest_after_m=0.01,
    largest_after_all_m=0.02, rmse_after_m=0.01, encounter_s=0.0, excused_outside_s=0.0,
    regained_s=None,
    recovery_s=None,
    avoidance_s=0.0, deadlock_s=0.0, saturated_s=0.0,
    holding_s=0.0, closest_uav_m=0.8, closest_obstacle_m=None, inside_keep_out_s=0.0,
    peak_force_n=20.0, energy_n2_s=100.0, check="",
)  # fmt: skip


def flights(*met: bool, error_m: float = 0.02) -> FlightTable:
    """Flights of two UAVs; the second one misses where the flight is not met."""
    rows = []
    for draw, kept in enumerate(met):
        word = "met" if kept else "missed"
        own = replace(ROW, draw=draw, flight_verdict=word, largest_after_all_m=error_m)
        cause = "" if kept else f"settled after {5 + draw}.25 s"
        rows += [own, replace(own, uav=2, verdict=word, cause=cause)]
    return table_of(rows)
