"""Sweeps from Python: the same rows as the runner's, and comparisons."""

from __future__ import annotations

import numpy as np
import pytest

from ptnsbc_sim.scenario import ScenarioError
from ptnsbc_sim.sweep.draws import SweepError
from ptnsbc_tools.library.flying import load, read_bag
from ptnsbc_tools.library.sweeping import Sweep, compare, open_sweep, sweep
from ptnsbc_tools.plotting.draw import blank_figure
from ptnsbc_tools.sweeps.comparison import ComparisonError

QUICK = {"timing.duration_s": 1.2, "gains.formation.deadline_s": 0.8}
VARY = {"plant.mass_kg": "1.0,1.2"}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Sweep:
    folder = tmp_path_factory.mktemp("library") / "sweep"
    quick = load("paper_5").with_(QUICK)
    return sweep(quick, 2, vary=VARY, starts="near:0.2", folder=folder, workers=1, progress=False)


def test_a_sweep_has_rows_shares_and_units(flown: Sweep) -> None:
    assert len(flown) == 4 and flown.met.of == 4
    assert len(flown["uav"]) == 20
    assert sorted(set(flown["drawn.plant.mass_kg"])) == [1.0, 1.2]
    assert flown.units["settling_s"] == "s" and flown.units["drawn.plant.mass_kg"] == "kg"
    assert repr(flown).startswith("<Sweep paper_5: flights met ")
    with pytest.raises(SweepError, match='did you mean "settling_s"'):
        flown["settling"]


def test_a_draw_is_flown_again_to_the_bit(flown: Sweep) -> None:
    assert flown.fly(3, progress=False).verdict.energy == pytest.approx(
        flown["energy_n2_s"][flown["draw"] == 3].sum(), rel=1e-12
    )
    assert flown.scenario(3).plant.mass_kg == 1.2


def test_a_kept_sweep_is_opened(flown: Sweep) -> None:
    again = open_sweep(flown.flown.folder)
    np.testing.assert_array_equal(again["energy_n2_s"], flown["energy_n2_s"])


def test_sweeps_of_the_same_draws_are_compared(flown: Sweep) -> None:
    off = load("paper_5").with_(QUICK, **{"formation.avoidance": "off"})
    other = sweep(off, 2, vary=VARY, starts="near:0.2", workers=1, progress=False)
    found = compare(flown, other)
    assert found.others[0].draws == 4
    assert repr(compare(flown, other, flown, names=["off", "same"])).endswith(
        "same is not worse at 5 %"
    )
    with pytest.raises(ComparisonError, match="2 others: expected one or more, with as many names"):
        compare(flown, other, flown, names=["off"])
    elsewhere = sweep(off, 1, vary=VARY, starts="near:0.1", workers=1, progress=False)
    with pytest.raises(ComparisonError, match="starts"):
        compare(flown, elsewhere)


def test_shares_are_drawn_against_what_was_drawn(flown: Sweep) -> None:
    axes = blank_figure((6, 4)).add_subplot()
    assert flown.plot_met(axes=axes) is axes
    assert axes.get_xlabel() == "plant.mass_kg [kg]"
    with pytest.raises(SweepError, match=r'did you mean "plant\.mass_kg"'):
        flown.plot_met("plant.mass")


def test_pandas_has_the_table(flown: Sweep) -> None:
    pytest.importorskip("pandas")
    frame = flown.to_pandas()
    assert len(frame) == 20 and frame.attrs["units"]["deadline_s"] == "s"


def test_the_summary_has_the_shares(flown: Sweep) -> None:
    first = flown.summary.rows[0]
    assert (first[""], first["count"], first["of"]) == ("flights met", flown.met.count, 4)
    assert first["low"] == pytest.approx(100 * flown.met.low)
    assert "flights inside a keep-out" in str(flown.summary)


def test_an_unknown_family_names_the_known_ones() -> None:
    with pytest.raises(ScenarioError, match=r"nowhere: no such family: expected one of: anywhere"):
        sweep(load("paper_5_free"), 1, family="nowhere", workers=1)


def test_two_flights_are_compared_and_a_flight_with_a_sweep_is_not(flown: Sweep) -> None:
    flight = read_bag("bags/sample")
    assert not compare(flight, flight).worse
    with pytest.raises(ComparisonError, match="expected sweeps, or flights"):
        compare(flight, flown)
