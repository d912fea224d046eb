"""The table of a sweep as arrays of UAVs and of flights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_sim.sweep import SweepError
from ptnsbc_tools.sweeps.table import plan_in, read_sweep, table_of


def test_a_flight_has_the_worst_figure_of_its_uavs(made) -> None:
    near = replace(made.ROW, closest_uav_m=0.5, error_at_deadline_m=0.3, largest_after_all_m=0.4)
    table = table_of([made.ROW, replace(near, uav=2), replace(made.ROW, draw=7)])
    flights = table.flights
    assert flights.draw.tolist() == [0, 7]
    assert flights.error_at_deadline_m.tolist() == [0.3, 0.01]
    assert flights.closest_uav_m.tolist() == [0.5, 0.8]
    assert flights.worst.tolist() == [1, 2]
    assert np.isnan(flights.closest_obstacle_m).all()


def test_an_error_that_is_not_finite_is_no_missing_error(made) -> None:
    rows = [
        replace(made.ROW, largest_after_m=float("nan"), largest_after_all_m=None),
        replace(made.ROW, draw=1, largest_after_m=None),
    ]
    table = table_of(rows)
    assert table["largest_after_m"][0] == np.inf
    assert np.isnan(table["largest_after_m"][1])
    assert np.isnan(table["largest_after_all_m"][0])


def test_a_uav_that_missed_is_worse_than_one_with_an_excused_error(made) -> None:
    excused = replace(made.ROW, largest_after_all_m=3.0)
    missed = replace(made.ROW, uav=2, verdict="missed", largest_after_all_m=0.1)
    assert table_of([excused, missed]).flights.worst.tolist() == [1]
    inside = replace(missed, uav=3, verdict="violated", largest_after_all_m=0.05)
    assert table_of([excused, missed, inside]).flights.worst.tolist() == [2]


def test_a_sweep_is_read_from_its_folder(flown: Path) -> None:
    sweep = read_sweep(flown)
    assert sweep.plan == plan_in(flown)
    assert sweep.table.flights.draw.tolist() == list(range(12))
    assert sweep.missing == 0
    assert set(sweep.table.drawn) == {"plant.mass_kg", "gains.formation.kappa_1_s"}
    assert sweep.table["verdict"].dtype.kind == "U"


def test_what_is_no_sweep_is_named(tmp_path: Path) -> None:
    with pytest.raises(SweepError, match="no sweep"):
        plan_in(tmp_path)
    (tmp_path / "plan.json").write_text("{}")
    with pytest.raises(SweepError, match="format"):
        plan_in(tmp_path)
    (tmp_path / "plan.json").write_text("{")
    with pytest.raises(SweepError, match="no plan of a sweep"):
        read_sweep(tmp_path)


def test_a_sweep_that_was_ended_early_is_named(flown: Path, tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_bytes((flown / "plan.json").read_bytes())
    with pytest.raises(SweepError, match="ended early"):
        read_sweep(tmp_path)
    (tmp_path / "table.parquet").write_bytes(b"PAR1")
    with pytest.raises(SweepError, match="cannot be read"):
        read_sweep(tmp_path)
