"""Fleets of stand-ins in which UAVs come and go, flown by bridges on a clock of the tests."""

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_fleet import MavlinkFleet

from ptnsbc_autopilot.fault_lines import inject
from ptnsbc_core.curves.trajectory import reference
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.verdict import verdict_on

JOINS_S, LEAVES_S = 16.0, 30.0
FIVE = {
    "name": "five",
    "timing.duration_s": 52.0,
    "communication": {
        "tree": {2: 1, 3: 1, 4: 2, 5: 3},
        "leader_links": [2, 3, 4, 5],
        "estimator_edges": [[2, 4], [3, 5]],
    },
    "leader": {
        "id": 1,
        "successors": [2, 3],
        "trajectory": {
            "kind": "circle", "centre_m": [0, 0, 6], "radius_m": 12, "rate_rad_s": 0.08
        },
    },
    "faults": [],
    "uavs": [
        {"id": 1, "position_m": [12, 0, 1]},
        {"id": 2, "position_m": [10, 3, 1]},
        {"id": 3, "position_m": [10, -3, 1]},
        {"id": 4, "position_m": [8, 5, 1], "leaves_s": LEAVES_S},
        {"id": 5, "position_m": [4, -5, 1], "joins_s": JOINS_S},
    ],
    "gains.formation.deadline_s": 10,
    "formation.tolerance_m": 0.15,
    "mavlink": {
        "autopilot": "px4",
        "acceleration_feed_forward": True,
        "takeoff_height_m": 5,
        "overrides": {"gains.formation.kappa_1_s": 1.2},
    },
}  # fmt: skip


def flown(folder, kind="px4", **changes):
    """Five UAVs in a V on a circle, one of which joins late, and one leaves."""
    file = folder / "five.yaml"  # by it the stand-ins know where they stand
    file.write_text(load_scenario("relay", {**FIVE, **changes}).text, "utf-8")
    fleet = MavlinkFleet(load_scenario(file).bridged(), kind, gnss="perfect")
    fleet.set_parameter("COM_OBL_RC_ACT", 5)
    return fleet.airborne().form()


def until_s(fleet, t_s, until=None):
    """Fly until a time of the mission."""
    now_s = (fleet.now_ns - fleet.legs[0][0]) * 1e-9
    fleet.run(t_s - now_s, until=until)


def off_place_m(fleet, uav_id, slot=None):
    """How far a vehicle is from its slot, or another one, beside the path of the leader."""
    made = fleet.scenario
    t = (fleet.now_ns - fleet.legs[0][0]) * 1e-9
    leader = np.array(reference(agent_config(made, 1).trajectory, t).position)
    truth = fleet.uavs[uav_id].vehicle.flight.truth.position_enu
    return float(np.linalg.norm(truth - leader - made.offset(slot or uav_id)))


def faults(fleet):
    found = {i: uav.bridge.procedure.fault for i, uav in fleet.uavs.items()}
    return {i: fault for i, fault in found.items() if fault}


@pytest.mark.slow
def test_vehicles_join_late_are_held_leave_and_lose_their_leader_to_a_pilot(tmp_path):
    """The joiner takes off with the others and waits over its start; who leaves is landed by its flight controller."""
    fleet = flown(tmp_path)
    leader, struck, leaver, joiner = (fleet.uavs[i] for i in (1, 3, 4, 5))
    waits = joiner.vehicle.flight.truth.position_enu.copy()
    until_s(fleet, JOINS_S)
    assert np.linalg.norm(joiner.vehicle.flight.truth.position_enu - waits) < 0.3
    until_s(fleet, 23.0)
    struck.alive = False
    fleet.run(3.0)
    held = struck.vehicle.flight.truth.position_enu.copy()
    fleet.run(2.0)
    assert struck.step is Step.HELD
    assert np.linalg.norm(struck.vehicle.flight.truth.position_enu - held) < 0.3
    assert off_place_m(fleet, 5) < 0.15
    struck.start_again()
    until_s(fleet, LEAVES_S)
    assert struck.step is Step.FLY
    begin = leaver.vehicle.flight.truth.position_enu.copy()
    until_s(fleet, 40.0)
    assert faults(fleet) == {}
    assert off_place_m(fleet, 3) < 0.15
    inject(leader.vehicle, "mode", "POSCTL", fleet.now_s)
    until_s(fleet, 52.05)
    assert (leader.step, leaver.step) == (Step.YIELDED, Step.DONE)
    assert fleet.uavs[2].controller.leads
    assert max(off_place_m(fleet, i) for i in (2, 3, 5)) < 0.15
    assert np.linalg.norm((leaver.vehicle.flight.truth.position_enu - begin)[:2]) < 1.5
    assert not leaver.vehicle.armed
    assert list(faults(fleet)) == [1]
    found = verdict_on(fleet.recording())
    assert found.verdict == "met", [(u.uav, u.verdict, u.reason) for u in found.uavs]
    assert [(one.uav, one.verdict) for one in found.uavs if one.verdict != "met"] == [(1, "void")]
    assert min(pair.distance_m for pair in found.separations) > 0.5


COLUMN = {
    "timing.duration_s": 34.0,
    "communication": {
        "tree": {2: 1, 3: 2}, "leader_links": [2, 3], "estimator_edges": [[2, 3]]
    },
    "leader": {
        "id": 1,
        "successors": [2],
        "trajectory": {"kind": "line", "position_m": [0, 0, 6], "velocity_m_s": [0.5, 0, 0]},
    },
    "formation.vacancy": "close_up",
    "formation.shape": {"kind": "column", "spacing_m": 2.5},
    "uavs": [{"id": i, "position_m": [3 - 3 * i, 0.5, 1]} for i in (1, 2, 3)],
}  # fmt: skip


@pytest.mark.slow
def test_when_the_bridge_of_the_leader_dies_the_others_move_up_past_its_vehicle(tmp_path):
    """Its failsafe holds it in the way of both, and nobody hears of it any more."""
    fleet = flown(tmp_path, **COLUMN)
    until_s(fleet, 14.0)
    leader, successor, last = fleet.uavs.values()
    leader.bridge_alive = False
    near_m = []
    while (fleet.now_ns - fleet.legs[0][0]) * 1e-9 < 34.0:
        fleet.run(0.1)
        place = leader.vehicle.flight.truth.position_enu
        near_m += [
            np.linalg.norm(one.vehicle.flight.truth.position_enu - place)
            for one in (successor, last)
        ]
    assert min(near_m) > 0.5
    assert leader.vehicle.armed  # its bridge stays away
    assert successor.controller.leads
    assert faults(fleet) == {}
    where_1_and_2_were = np.array([off_place_m(fleet, 2, slot=1), off_place_m(fleet, 3, slot=2)])
    assert where_1_and_2_were.max() < 0.15


ALL_FOLLOW_1 = {
    **COLUMN,
    "communication.tree": {2: 1, 3: 1},
    "leader.successors": [],
    "formation.vacancy": None,
    "formation.tolerance_m": 0.5,
}


@pytest.mark.slow
def test_the_place_of_a_vehicle_without_a_bridge_is_kept_clear(tmp_path):
    """Seen on a real PX4: the others forgot it after 5 s, and passed it at 0.57 m."""
    fleet = flown(tmp_path, **ALL_FOLLOW_1)
    until_s(fleet, 14.0)
    silent, last = fleet.uavs[2], fleet.uavs[3]
    silent.bridge_alive = False
    away_m = []

    def off():
        ends = (one.vehicle.flight.truth.position_enu for one in (silent, last))
        return np.subtract(*ends)

    def beside():
        away_m.append(np.linalg.norm(off()))
        return off()[0] < -1.0

    fleet.run(15.0, until=beside)  # it hovers, and the last one comes from behind
    assert min(away_m) > 0.5
    assert last.step is Step.FLY, fleet.report()
    assert silent.vehicle.armed
