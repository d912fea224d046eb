"""The table of a sweep, and shares of flights in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_sim.sweep import SweepError
from ptnsbc_tools.sweeps.table import plan_in, read_sweep, share, share_of, table_of


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


def test_an_interval_by_hand() -> None:
    found = share(13, 20)
    z, n, p = 1.959963984540054, 20, 0.65
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert (found.low, found.high) == pytest.approx((centre - half, centre + half))
    assert found.wide
    assert str(found) == "13 of 20, 65.0 % (43.3 to 81.9 %, wide)"


def test_none_and_all_have_one_bound() -> None:
    assert str(share(0, 1000)) == "0 of 1000, 0.0 % (at most 0.383 %)"
    assert str(share(1000, 1000)) == "1000 of 1000, 100.0 % (at least 99.617 %)"
    assert share(0, 40).interval == "at most 8.8 %"
    assert share(0, 0).as_json()["share"] is None
    assert str(share(0, 0)) == "0 of 0"


def test_wide_is_more_than_a_fifth() -> None:
    assert share(50, 60).high - share(50, 60).low < 0.2
    assert not share(50, 60).wide
    assert share(5, 10).wide


def test_the_share_of_true() -> None:
    found = share_of(np.array([True, False, True]))
    assert (found.count, found.of) == (2, 3)
