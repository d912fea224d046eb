"""What a sweep found, as tables and as JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep.draws import SweepError, parse_axis
from ptnsbc_sim.sweep.plan import plan_of
from ptnsbc_tools.sweeps import summary
from ptnsbc_tools.sweeps.summary import (
    FlightTable,
    FlownSweep,
    plan_in,
    read_sweep,
    share,
    share_of,
    table_of,
)

BASE = load_scenario("paper_5")


def sweep_of(table, draws: int, **rest) -> FlownSweep:
    return FlownSweep(plan_of(BASE, draws, **rest), Path("there"), table)


def test_shares_and_causes(made) -> None:
    sweep = sweep_of(made.flights(True, False, False, True), 4)
    assert str(summary.flights_met(sweep)).startswith("2 of 4")
    shares = summary.shares(sweep)
    assert str(shares["uavs"]).startswith("6 of 8")
    assert shares["inside_keep_out"].count == 0
    assert summary.causes(sweep) == [("missed", "settled after … s", 2)]


def test_the_worst_flight_is_one_that_did_not_meet(made) -> None:
    sweep = sweep_of(made.flights(True, False, True), 3)
    first, *others = summary.worst(sweep)
    assert (first.draw, first.uav, first.verdict) == (1, 2, "missed")
    assert first.command == "ptnsbc simulate --sweep there --draw 1"
    assert [one.draw for one in others] == [0, 2]


def test_a_flight_inside_a_keep_out_is_named_before_a_larger_error(made) -> None:
    missed = replace(made.ROW, verdict="missed", flight_verdict="missed", largest_after_all_m=9.0)
    inside = replace(made.ROW, draw=1, verdict="violated", flight_verdict="violated")
    found = summary.worst(sweep_of(table_of([missed, inside]), 2))
    assert [(one.draw, one.verdict) for one in found] == [(1, "violated"), (0, "missed")]


def test_the_cells_of_a_grid(made) -> None:
    axes = (parse_axis("plant.mass_kg=1.0,1.2"),)
    table = made.flights(True, False, True, False)
    masses = np.repeat([1.0, 1.2, 1.0, 1.2], 2)
    table = type(table)({**table.columns, "drawn.plant.mass_kg": masses})
    found = summary.cells(sweep_of(table, 2, axes=axes))
    assert [(one["plant.mass_kg"], kept.count, kept.of) for one, kept in found] == [
        (1.0, 2, 2),
        (1.2, 0, 2),
    ]


def test_flights_that_do_not_differ_are_said(made) -> None:
    table = made.flights(True, True, True)
    assert "all are the same flight" in summary.line(sweep_of(table, 3)).plain
    energy = np.array([1.0, 1.0, 2.0, 1.0, 1.0, 2.0])
    varied = type(table)({**table.columns, "energy_n2_s": energy})
    assert varied.different == 3
    assert "differ" not in summary.line(sweep_of(varied, 3)).plain


def test_draws_that_are_missing_are_said(made) -> None:
    sweep = sweep_of(made.flights(True, True), 5)
    assert "3 of 5 draws were not flown" in summary.line(sweep).plain
    assert "wide" in summary.line(sweep).plain


@pytest.mark.parametrize(
    "text", ["plant.mass_kg=1:1.4", "plant.mass_kg=1.2±0.1", "gains.formation.deadline_s=3,5"]
)
def test_an_axis_is_shown_as_it_was_given(made, text: str) -> None:
    plan = plan_of(BASE, 2, axes=(parse_axis(text),))
    assert summary.title(FlownSweep(plan, Path("there"), made.flights(True, True))).endswith(text)


def test_errors_stand_with_and_without_excused_spans(flown: Path) -> None:
    data = json.loads(json.dumps(summary.as_json(read_sweep(flown)), allow_nan=False))
    assert {"largest_after_m", "largest_after_all_m"} <= set(data["figures"]) | {"largest_after_m"}
    assert data["figures"]["closest_uav_m"]["min"] > 0.0
    assert len(data["cells"]) == 2
    assert sum(one["of"] for one in data["cells"]) == data["flights"]["of"] == 12
    titles = [str(table.title) for table in summary.tables(read_sweep(flown))]
    assert titles[0].startswith("small: 12 flights, seed 0; plant.mass_kg=1,1.2")


def test_what_the_dry_runs_foresaw(made) -> None:
    """Of four accepted flights one is not met; of two refused ones one would have met."""
    table = made.flights(True, True, True, False, True, False)
    said = np.repeat(["accepted"] * 4 + ["refused"] * 2, 2)
    sweep = sweep_of(FlightTable({**table.columns, "check": said}), 6)
    found = {name: (one.count, one.of) for name, one in summary.dry_runs(sweep).items()}
    assert list(found.values()) == [(4, 6), (3, 4), (1, 6), (1, 2)]
    assert summary.as_json(sweep)["dry_runs"]["accepted flights met"]["count"] == 3


def test_without_dry_runs_nothing_is_said_of_them(made) -> None:
    assert summary.dry_runs(sweep_of(made.flights(True, False), 2)) == {}


def test_a_flight_inside_a_keep_out_is_not_met(made) -> None:
    table = made.flights(True, True)
    verdicts = np.array(["met", "met", "violated", "violated"])
    sweep = sweep_of(FlightTable({**table.columns, "flight_verdict": verdicts}), 2)
    shares = summary.shares(sweep)
    assert (shares["inside_keep_out"].count, shares["flights"].count) == (1, 1)


def test_a_deadlock_of_one_uav_counts_once_for_its_flight(made) -> None:
    table = made.flights(True, True, True)
    sweep = sweep_of(
        FlightTable({**table.columns, "deadlock_s": np.array([0, 0.5, 1, 2, 0, 0])}), 3
    )
    deadlocks = summary.shares(sweep)["deadlocks"]
    assert (deadlocks.count, deadlocks.of) == (2, 3)
    assert summary.as_json(sweep)["deadlocks"]["count"] == 2


def test_a_flight_has_the_worst_figure_of_its_uavs(made) -> None:
    near = replace(made.ROW, closest_uav_m=0.5, error_at_deadline_m=0.3, largest_after_all_m=0.4)
    near, far = replace(near, keep_out_margin=0.0), replace(made.ROW, keep_out_margin=0.6)
    table = table_of([far, replace(near, uav=2), replace(made.ROW, draw=7)])
    flights = table.flights
    assert flights.draw.tolist() == [0, 7]
    assert table.of_flights("error_at_deadline_m").tolist() == [0.3, 0.01]
    assert table.of_flights("closest_uav_m").tolist() == [0.5, 0.8]
    assert table.of_flights("keep_out_margin").tolist()[0] == 0.0
    assert flights.worst.tolist() == [1, 2]
    assert np.isnan(table.of_flights("closest_obstacle_m")).all()


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
