"""What a viewer knows of a flight, from made messages."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.wire import Diagnostics, DiagnosticStatus, HeaderFields, Stamped
from ptnsbc_nodes.comm.announcements import Decision, LostProcess
from ptnsbc_nodes.view.flight_state import SILENT_S, FlightState, RecentStates, scenario_of
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.slots import with_slots
from ptnsbc_sim.verdict.formation_error import formation_errors
from ptnsbc_sim.verdict.recording import Phase

SCENARIO = load_scenario("paper_5")
EPOCH_NS = 7_000_000_000


class Steady:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def odometry(position, t_s: float) -> Stamped:
    values = np.zeros(13)
    values[:3], values[6] = position, 1.0
    return Stamped(EPOCH_NS + round(t_s * 1e9), values)


def status(name: str, level: int = 0, message: str = "", **values: str) -> Diagnostics:
    return Diagnostics(0, (DiagnosticStatus(name, level, message, values),))


def in_formation(t_s: float, clock: Steady | None = None) -> FlightState:
    """Every follower at its place beside a leader at the origin, but UAV 3 half a metre above."""
    state = FlightState(SCENARIO, clock or Steady())
    state.on_leg(HeaderFields(EPOCH_NS, "form"))
    for uav in SCENARIO.uav_ids:
        above = np.array([0.0, 0.0, 0.5 if uav == 3 else 0.0])
        state.on_odometry(uav, odometry(SCENARIO.offset(uav) + above, t_s))
    return state


def test_before_the_start_nothing_is_claimed() -> None:
    frame = FlightState(SCENARIO, Steady()).frame()
    assert (frame["t"], frame["left_s"], frame["leg"]) == (None, None, "waiting")
    assert all(uav["pose"] is None and uav["error"] is None for uav in frame["uavs"])
    json.dumps(frame, allow_nan=False)


def test_time_deadline_errors_and_the_nearest() -> None:
    frame = in_formation(2.0).frame()
    assert frame["t"] == pytest.approx(2.0)
    assert frame["left_s"] == pytest.approx(SCENARIO.gains.formation.deadline_s - 2.0)
    errors = {uav["id"]: uav["error"] for uav in frame["uavs"]}
    assert errors[3] == pytest.approx(0.5)
    assert errors[2] == errors[4] == errors[5] == 0.0
    places = {
        u: SCENARIO.offset(u) + np.array([0.0, 0.0, 0.5 * (u == 3)]) for u in SCENARIO.uav_ids
    }
    gaps = [float(np.linalg.norm(places[2] - places[u])) for u in SCENARIO.uav_ids if u != 2]
    [second] = [uav for uav in frame["uavs"] if uav["id"] == 2]
    assert second["near"]["distance"] == pytest.approx(min(gaps), abs=1e-4)


@pytest.mark.parametrize("name", ["paper_5", "show_20", "figure_eight"])
def test_the_errors_are_those_of_the_verdict(name) -> None:
    scenario = load_scenario(name)
    rng = np.random.default_rng(7)
    positions = {uav: rng.uniform(-3.0, 3.0, 3) for uav in scenario.uav_ids}
    slots = dict(zip(scenario.uav_ids, scenario.uav_ids, strict=True))
    if name == "show_20":
        slots[2], slots[3] = 3, 2
    state = FlightState(scenario, Steady())
    state.on_leg(HeaderFields(EPOCH_NS, "form"))
    for uav, place in positions.items():
        state.on_odometry(uav, odometry(place, 3.2))
    state.on_slots(Decision(EPOCH_NS, slots))
    flown = with_slots(scenario, slots)
    phase = Phase(EPOCH_NS, flown, frozenset(), frozenset())
    recording = SimpleNamespace(first_ns=EPOCH_NS, phases=(phase,))
    block = SimpleNamespace(
        stamps=np.array([EPOCH_NS + 3_200_000_000]),
        positions=np.array([positions[uav] for uav in scenario.uav_ids]).T[..., None],
    )
    expected = dict(zip(scenario.uav_ids, formation_errors(recording, block), strict=True))
    for uav in state.frame()["uavs"]:
        assert uav["error"] == pytest.approx(expected[uav["id"]][0], abs=1e-4)


def test_a_leg_that_holds_has_no_deadline() -> None:
    state = in_formation(3.0)
    state.on_leg(HeaderFields(EPOCH_NS + 2_500_000_000, "hold"))
    frame = state.frame()
    assert (frame["leg"], frame["left_s"]) == ("hold", None)
    assert frame["since_s"] == pytest.approx(0.5)


def test_a_landing_has_neither_deadline_nor_errors_whoever_ordered_it() -> None:
    state = in_formation(9.0)
    for uav in SCENARIO.uav_ids:
        step = "in formation" if uav == 1 else "landing"
        state.processes.on_status(status(f"bridge{uav}: link", step=step, armed="true"))
    assert state.frame()["landing"] == ""  # one lands, the others fly on
    state.processes.on_status(status("bridge1: link", step="done", armed="false"))
    sinking = odometry(SCENARIO.offset(3) + np.array([0.0, 0.0, 3.7]), 9.1)
    sinking.values[9] = -0.7
    for uav in SCENARIO.uav_ids:
        state.on_odometry(uav, sinking if uav == 3 else odometry(SCENARIO.offset(uav), 9.1))
    frame = state.frame()
    assert (frame["leg"], frame["left_s"]) == ("land", None)
    assert frame["landing"] == "landing, 3.7 m, 1 of 5"
    assert {uav["error"] for uav in frame["uavs"]} == {None}


def test_faults_lost_and_silent_processes_are_named() -> None:
    clock = Steady()
    state = in_formation(1.0, clock)
    state.processes.on_status(status("uav2: planner", 1, "holding", ready="true", mode="form"))
    state.processes.on_status(status("uav10: planner", ready="false", waiting_for="/uav1/odom"))
    state.processes.on_lost(LostProcess("uav4", 4))
    words = {one["name"]: (one["level"], one["word"]) for one in state.frame()["processes"]}
    assert words == {
        "uav2": (1, "holding"),
        "uav4": (2, "has ended"),
        "uav10": (1, "waits for /uav1/odom"),
    }
    assert list(words) == ["uav2", "uav4", "uav10"]
    assert [uav["lost"] for uav in state.frame()["uavs"]] == [False, False, False, True, False]
    clock.now_s = SILENT_S + 1.0
    silent = {one["name"]: one["word"] for one in state.frame()["processes"]}
    assert silent["uav2"] == "silent for 3 s"


def test_a_vehicle_shows_mode_arming_and_battery() -> None:
    state = in_formation(1.0)
    said = {"ready": "true", "mode": "OFFBOARD", "armed": "true", "battery_percent": "81"}
    said["fix"] = "RTK float"
    state.processes.on_status(status("bridge2: link", **said))
    [second] = [uav for uav in state.frame()["uavs"] if uav["id"] == 2]
    assert (second["vehicle"], second["armed"], second["battery"]) == ("OFFBOARD", True, 81)
    assert second["fix"] == "RTK float"
    said["battery_percent"] = 5000 * "9"  # int() of it ended the view
    state.processes.on_status(status("bridge2: link", **said))
    assert [uav["battery"] for uav in state.frame()["uavs"]] == [None] * len(SCENARIO.uav_ids)


def readiness_of(*statuses: Diagnostics) -> str | None:
    state = FlightState(SCENARIO, Steady())
    for one in statuses:
        state.processes.on_status(one)
    [second] = [uav for uav in state.frame()["uavs"] if uav["id"] == 2]
    return second["readiness"]


def test_the_board_names_a_fault_or_what_is_awaited_or_the_step() -> None:
    planner = status("uav2: planner", ready="false", waiting_for="/uav2/odom")
    link = {"step": "waiting for the mode", "ready": "false", "waiting_for": "waiting for the mode"}
    ready = {"step": "ready to arm, waiting for the others", "ready": "true", "fault": ""}
    assert readiness_of() is None
    assert readiness_of(planner) == "/uav2/odom"
    assert readiness_of(status("uav2: planner", ready="true")) == "ready"
    assert readiness_of(planner, status("bridge2: link", **link)) == "waiting for the mode"
    assert readiness_of(planner, status("bridge2: link", **ready)) == ready["step"]
    refused = status("bridge2: link", **link | {"fault": "arming refused"})
    assert readiness_of(planner, refused) == "arming refused"


def test_the_pace_is_flight_time_per_wall_time() -> None:
    clock = Steady()
    state = in_formation(0.0, clock)
    clock.now_s = 2.0
    state.on_odometry(1, odometry((0.0, 0.0, 0.0), 5.0))
    assert state.frame()["pace"] == pytest.approx(2.5)
    clock.now_s = 2.0 + SILENT_S + 0.1
    assert state.frame()["pace"] == 0.0


def test_a_fleet_without_a_scenario_is_refused() -> None:
    with pytest.raises(PtnsbcError, match="expected one: ptnsbc view SCENARIO"):
        scenario_of("")
    assert scenario_of(SCENARIO.text).uav_ids == SCENARIO.uav_ids


PERIOD_NS = 10_000_000
MS = 1_000_000


def told(stamp_ns: int, position: tuple[float, float, float]) -> Stamped:
    values = np.zeros(13)
    values[:3], values[6] = position, 1.0
    return Stamped(stamp_ns, values)


def test_positions_are_interpolated_at_what_all_have_reached() -> None:
    states = RecentStates()
    assert (states.common_ns, states.at(0)) == (-1, {})
    for tick in range(4):
        states.add(1, told(tick * PERIOD_NS, (1.0 * tick, 0.0, 0.0)))
    for stamp_ns in (3 * MS, 24 * MS, 14 * MS):  # the last was overtaken
        states.add(2, told(stamp_ns, (0.0, 1e-6 * stamp_ns, 0.0)))
    assert states.common_ns == 24 * MS
    found = states.at(24 * MS)
    np.testing.assert_allclose(found[1][:3], (2.4, 0.0, 0.0))
    np.testing.assert_allclose(found[2][:3], (0.0, 24.0, 0.0))


def test_nobody_waits_for_a_silent_vehicle() -> None:
    states = RecentStates()
    states.add(2, told(0, (5.0, 0.0, 0.0)))
    for tick in range(200):
        states.add(1, told(tick * PERIOD_NS, (0.0, 0.0, 0.0)))
    assert states.common_ns == 199 * PERIOD_NS
    assert states.at(states.common_ns)[2][0] == 5.0
    states.add(2, told(200 * PERIOD_NS, (6.0, 0.0, 0.0)))
    assert states.common_ns == 199 * PERIOD_NS
    states.add(1, told(0, (7.0, 0.0, 0.0)))  # time has begun anew
    assert states.at(0)[1][0] == 7.0


def test_errors_of_a_moving_formation_do_not_depend_on_the_order_of_messages() -> None:
    """UAVs in place move at 2 m/s; between the first and the last message of a tick the errors stay zero."""
    scenario = load_scenario("paper_5")
    state = FlightState(scenario, lambda: 0.0)
    state.on_leg(HeaderFields(0, "form"))
    for tick in range(6):
        stamp_ns = tick * PERIOD_NS
        moved = np.array([2e-9 * stamp_ns, 0.0, 0.0])
        for uav in scenario.uav_ids:
            state.on_odometry(uav, told(stamp_ns, tuple(moved + scenario.offset(uav))))
            errors = [
                one["error"] for one in state.frame()["uavs"] if one["id"] != scenario.leader.id
            ]
            assert tick == 0 or errors == [0.0] * len(scenario.followers)
