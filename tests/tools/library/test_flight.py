"""A flight as arrays: against closed forms of synthetic recordings, and against the simulator's own buffers."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.swarm import fly as fly_headless
from ptnsbc_sim.verdict import Recording
from ptnsbc_sim.verdict.recording import recording_of
from ptnsbc_tools.library.flight import QUANTITIES, Flight, FlightError, flight_in
from ptnsbc_tools.ros import LibraryMissingError

Fly = Callable[..., Recording]


@pytest.fixture(scope="module")
def flight(scenario: Scenario) -> Flight:
    headless = fly_headless(scenario)
    return Flight(recording_of(headless), headless=headless)


def test_every_quantity_has_the_shape_of_its_axes(flight: Flight) -> None:
    lengths = {"time_s": 150, "uav": 5, "axis": 3, "component": 4}
    for one in QUANTITIES:
        assert flight[one.name].shape == tuple(lengths[axis] for axis in one.axes), one.name


def test_the_arrays_are_those_of_the_simulator(flight: Flight) -> None:
    track = flight.headless.track
    np.testing.assert_array_equal(flight.position_m, track.odometry[:, :, :3])
    np.testing.assert_array_equal(flight.force_n, track.wrench[:, :, :3])
    turn = Rotation.from_quat(flight.quaternion.reshape(-1, 4))
    world = turn.apply(track.odometry[:, :, 7:10].reshape(-1, 3)).reshape(150, 5, 3)
    np.testing.assert_allclose(flight.velocity_m_s, world, atol=1e-12)


def test_the_velocity_is_the_rate_of_the_position(flight: Flight) -> None:
    rate = np.gradient(flight.position_m, flight.time_s, axis=0)[1:-1]
    assert np.abs(rate - flight.velocity_m_s[1:-1]).max() < 0.05  # 10 m/s^2 over half a tick


def test_errors_are_those_that_were_put_in(fly: Fly) -> None:
    flight = Flight(fly({4: lambda t: 0.2 + 0 * t}, seconds=7.0))
    np.testing.assert_allclose(flight.error_m[:, 3], 0.2, atol=1e-9)
    np.testing.assert_allclose(flight.error_m[:, :3], 0.0, atol=1e-9)
    assert flight.verdict.verdict == "missed"
    assert replace(flight, tolerance_m=0.3).verdict.verdict == "met"
    assert "verdict missed" in repr(flight)


def test_what_is_not_recorded_is_nan(fly: Fly) -> None:
    flight = Flight(fly(seconds=7.0))
    assert np.isnan(flight.leader_estimate_m).all()
    assert np.isfinite(flight.force_n).all()


def test_an_unknown_name_is_told_the_closest(fly: Fly) -> None:
    flight = Flight(fly(seconds=7.0))
    with pytest.raises(FlightError, match='did you mean "position_m"'):
        flight["positions_m"]
    with pytest.raises(FlightError, match='did you mean "errors"'):
        flight.plot("error")
    with pytest.raises(FlightError, match="latency: nothing to draw"):
        flight.plot("latency")


def test_figures_are_drawn_on_the_given_axes(flight: Flight) -> None:
    from ptnsbc_tools.plotting.draw import blank_figure

    figure = blank_figure((6, 4))
    axes = figure.add_subplot()
    assert flight.plot_errors(axes) is axes
    assert axes.get_ylabel() == "formation error [m]"
    assert (
        len(flight.plot_paths(figure.add_subplot()).lines) == 5 + 5 + 2 * 4
    )  # paths, UAVs, the tree at two times
    assert flight.plot("gain", figure.add_subplot()).lines


def test_a_figure_for_a_paper_is_saved(flight: Flight, tmp_path: Path) -> None:
    path = flight.save_picture(tmp_path / "e.pdf", "errors", columns="one")
    content = path.read_bytes()
    assert b"/Type3" not in content and b"/MediaBox [ 0 0 252 " in content
    with pytest.raises(PtnsbcError, match="columns three: expected one of: one, two"):
        flight.save_picture(tmp_path / "f.pdf", "errors", columns="three")
    with pytest.raises(PtnsbcError, match='eror: no figure of a flight: did you mean "errors"'):
        flight.save_picture(tmp_path / "f.pdf", "eror")


def test_a_bag_gives_the_same_arrays(flight: Flight, headless: Path) -> None:
    read = flight_in(headless)
    for one in QUANTITIES:
        np.testing.assert_allclose(read[one.name], flight[one.name], atol=1e-12, err_msg=one.name)
    with pytest.raises(FlightError, match="in a bag already"):
        read.save(headless.with_name("again"))


def test_a_flight_is_saved_and_read(flight: Flight, tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    saved = flight.save(tmp_path / "bag")
    assert saved.bag == tmp_path / "bag"
    np.testing.assert_array_equal(flight_in(saved.bag).position_m, flight.position_m)


def test_pandas_has_a_row_for_each_instant_and_uav(flight: Flight) -> None:
    pytest.importorskip("pandas")
    frame = flight.to_pandas()
    assert len(frame) == 150 * 5
    of_three = frame[frame.uav == 3]
    np.testing.assert_array_equal(of_three["position_m.y"], flight.position_m[:, 2, 1])
    assert frame.attrs["units"]["velocity_m_s.x"] == "m/s"


def test_the_summary_is_that_of_the_verdict(flight: Flight) -> None:
    rows = flight.summary.rows
    assert [row["UAV"] for row in rows] == list(flight.uavs)
    assert [row["start m"] for row in rows] == [of.start_error_m for of in flight.verdict.uavs]
    assert str(flight.verdict) == "<Verdict on paper_5: void, 0 of 5 in place at the deadline>"


def test_without_pandas_the_error_says_what_to_install(
    fly: Fly, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(LibraryMissingError, match=r"to_pandas\(\): pandas is not installed: pip"):
        Flight(fly(seconds=7.0)).to_pandas()
