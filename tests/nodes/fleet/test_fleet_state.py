"""What the operator's interface computes of a fleet's messages."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from ptnsbc_io.wire import Diagnostics, HeaderFields, Stamped
from ptnsbc_io.wire.diagnostics import DiagnosticStatus
from ptnsbc_nodes.comm.slots import Decision
from ptnsbc_nodes.fleet.fleet_state import STALE_S, FleetReport
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.slots import with_slots
from ptnsbc_sim.verdict.deadline import formation_errors

T0_NS, NOW_NS = 2_000_000_000, 5_200_000_000


def report_of(scenario, positions):
    report = FleetReport(scenario)
    report.on_epoch(HeaderFields(T0_NS, "form"))
    for uav, place in positions.items():
        report.on_odometry(uav, Stamped(NOW_NS, (*place, *[0.0] * 10)))
    return report


def status(name, level=0, message="", **values):
    return Diagnostics(0, (DiagnosticStatus(f"{name}: planner", level, message, values),))


@pytest.mark.parametrize("name", ["paper_5", "show_20", "figure_eight"])
def test_the_errors_are_those_of_the_verdict(name):
    scenario = load_scenario(name)
    rng = np.random.default_rng(7)
    positions = {uav: rng.uniform(-3.0, 3.0, 3) for uav in scenario.uav_ids}
    slots = dict(zip(scenario.uav_ids, scenario.uav_ids, strict=True))
    if name == "show_20":
        slots[2], slots[3] = 3, 2
    report = report_of(scenario, positions)
    report.on_slots(Decision(T0_NS, slots))
    recording = SimpleNamespace(flown=with_slots(scenario, slots), first_ns=T0_NS)
    tracks = {uav: place[None, :] for uav, place in positions.items()}
    expected = formation_errors(recording, np.array([NOW_NS]), tracks)
    found = report.errors_m()
    assert found == {uav: pytest.approx(error[0], abs=1e-12) for uav, error in expected.items()}


def test_a_uav_far_from_its_place_and_a_silent_one_are_not_in_place():
    scenario = load_scenario("paper_5")
    report = report_of(scenario, {1: (0.0, 0.0, 0.0)})
    leader = np.zeros(3) - (report.errors_m()[1], 0.0, 0.0)  # somewhere
    places = {uav: leader + scenario.offset(uav) for uav in scenario.uav_ids}
    places[4] = places[4] + (0.2, 0.0, 0.0)
    report = report_of(scenario, places)
    for uav in (2, 4, 5):
        report.on_status(status(f"uav{uav}", ready="true", mode="form"), 10.0)
    late = report.not_in_place(report.errors_m(), 10.0 + STALE_S / 2)
    assert set(late) - {1} == {3, 4}  # 3 was never heard, 4 is 0.2 m off
    assert set(report.not_in_place(report.errors_m(), 10.1 + STALE_S)) == {1, 2, 3, 4, 5}


def test_only_a_leg_in_formation_has_places_and_a_predefined_time():
    scenario = load_scenario("paper_5")
    report = report_of(scenario, {uav: (0.0, 0.0, 0.0) for uav in scenario.uav_ids})
    assert report.predefined_time_s == scenario.file.gains.formation.deadline_s
    assert report.share_of_time() == pytest.approx(3.2 / report.predefined_time_s)
    report.on_epoch(HeaderFields(NOW_NS - 1, "hold"))
    assert report.predefined_time_s == report.share_of_time() == 0.0
    assert report.errors_m() == {}
    assert report.not_in_place({}, 0.0) == []


def test_no_status_ends_it():
    report = FleetReport(load_scenario("paper_5"))
    for name in ("uav", "uav99999999", "uav6", "sim", "bridge1", "\x00", "uav1uav2", "uav²"):
        report.on_status(status(name, 77, "?", avoidance_active_s="many", holding_s=""), 1.0)
    report.on_status(status("uav2", 1, "holding", avoidance_active_s="many"), 1.0)
    assert (report.uavs[2].level, report.uavs[2].reason) == (1, "holding")
    assert np.isnan(report.uavs[2].avoidance_active_s)
