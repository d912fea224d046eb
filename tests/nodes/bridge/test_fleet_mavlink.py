"""Fleets of stand-ins flown by bridges, on a clock of the tests."""

from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_fleet import AUTOPILOTS, MavlinkFleet, scenario

from ptnsbc_autopilot.fault_lines import inject
from ptnsbc_core.curves.trajectory import reference
from ptnsbc_nodes.bridge.procedure.steps import Step, Stream
from ptnsbc_nodes.emergency import Order
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.mission.legs import formed_s
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.deadline import MET

PLUGINS = Path(__file__).parents[3] / "examples" / "plugins"
ABOVE_M = 0.5
OWN_FUNCTIONS = f"""
import math


def above(inputs):
    # the leader has the smallest id of those heard
    leader = inputs.positions[0] + inputs.ages_s[0] * inputs.velocities[0]
    velocity = inputs.velocities[0] + leader + inputs.offset - inputs.position
    velocity[2] += {ABOVE_M}
    return velocity


def bow(t):
    return 0.2 * t, 1.0 - math.cos(0.2 * t), 3.0 + 0.02 * t
"""
OWN_SCENARIO = """
extends: experiment_4
name: mine
communication: {tree: {2: 1, 3: 1, 4: 1}}
leader:
  trajectory: {kind: mine.py:bow, duration_s: 30}
"""
OWN_LAW = """
law: mine.py:above
mavlink: {takeoff_height_m: 2}
"""
OWN_TASK = f"""
mavlink: {{takeoff_height_m: 2, setpoint: attitude}}
plugins:
  task: {PLUGINS / "cylinder.py"}:cylinder
  controller: {PLUGINS / "proportional.py"}:proportional
"""

MISSION = {
    "formation.frame": "world",
    "timing.duration_s": 53.0,
    "mission.legs": [
        {"kind": "take_off", "height_m": 5, "over_s": 4},
        {"kind": "form", "over_s": 9},
        {"kind": "change", "shape": {"kind": "line", "spacing_m": 3}, "over_s": 7},
        {"kind": "go_to", "position_m": [0, 0, 6], "over_s": 6},
        {
            "kind": "split",
            "name": "away",
            "head": 3,
            "over_s": 5,
            "trajectory": {"kind": "hover", "position_m": [2, -6, 7]},
        },
        {"kind": "join", "over_s": 5},
        {"kind": "land", "over_s": 16},
    ],
    "world.obstacles": [
        {
            "name": "ball",
            "keep_out_m": 0.8,
            "trajectory": {
                "kind": "line",
                "position_m": [-22.4, 2.4, 6],
                "velocity_m_s": [0.8, 0, 0],
            },
        }
    ],
}


@pytest.mark.slow
def test_four_vehicles_take_off_form_by_the_deadline_and_land():
    """By attitude targets; by velocities the flights below, and bare motors in test_attitude_targets.py."""
    kind = "arducopter"
    fleet = MavlinkFleet(scenario(kind, "attitude"), kind, gnss="perfect", spread_m=30.0)
    fleet.set_parameter("GUID_OPTIONS", 8)
    fleet.airborne().form().run(12.6).land()
    assert [uav.step for uav in fleet.uavs.values()] == [Step.DONE] * 4, fleet.report()
    assert {uav.bridge.procedure.fault for uav in fleet.uavs.values()} == {""}
    assert not any(uav.vehicle.armed for uav in fleet.uavs.values())
    found = verdict_on(fleet.recording())
    assert found.verdict == "met", [(u.uav, u.reason) for u in found.uavs]
    assert min(pair.distance_m for pair in found.separations) > 0.5


@pytest.mark.slow
def test_four_vehicles_fly_a_figure_of_eight_in_a_v_that_turns():
    kind = "arducopter"
    changes = {"mavlink.autopilot": AUTOPILOTS[kind], "timing.duration_s": 24.0}
    made = load_scenario("figure_eight_4", changes).bridged()
    fleet = MavlinkFleet(made, kind, gnss="perfect")
    fleet.set_parameter("GUID_OPTIONS", 8)
    fleet.airborne().form().run(24.6)
    assert {uav.bridge.procedure.fault for uav in fleet.uavs.values()} == {""}
    found = verdict_on(fleet.recording())
    assert found.verdict == "met", [(u.uav, u.reason) for u in found.uavs]
    assert max(one.max_error_after_all_m for one in found.uavs) < 0.15
    assert min(pair.distance_m for pair in found.separations) > 1.5


@pytest.mark.slow
def test_four_vehicles_fly_a_mission_from_the_ground_to_the_ground():
    """Their own take-off ends where the leg take_off begins; land is the landing of their flight controllers.

    A ball flies through the place of UAV 2 while UAV 3 is apart.
    """
    # From V to line the place of UAV 4 moves at more than 1 m/s beside the leader: nobody runs away.
    made = load_scenario("take_off_4", {**MISSION, "mavlink.abort.away_m_s": 1.0}).bridged()
    fleet = MavlinkFleet(made, "px4", gnss="perfect", spread_m=30.0)
    fleet.airborne().form()
    fleet.run(
        made.timing.duration_s,
        until=lambda: all(u.bridge.procedure.over for u in fleet.uavs.values()),
    )
    assert {uav.bridge.procedure.fault for uav in fleet.uavs.values()} == {""}
    found = verdict_on(fleet.recording())
    kinds = ("take_off", "form", "change", "go_to", "split", "join", "land")
    assert [(leg.kind, leg.verdict) for leg in found.mission] == [(kind, "met") for kind in kinds]
    assert [uav.step for uav in fleet.uavs.values()] == [Step.DONE] * 4, fleet.report()
    assert not any(uav.vehicle.armed for uav in fleet.uavs.values())  # down before land is due
    assert min(pair.distance_m for pair in found.separations) > 0.5
    (ball,) = made.world.bodies
    away_m, ways_m = passed(fleet, ball, 2)
    assert min(away_m) > ball.keep_out_m > min(ways_m)


def passed(fleet, ball, uav_id):
    """The distances [m] of a UAV to a ball that moves, and those that its place has during the leg split."""
    uav, made = fleet.uavs[uav_id], fleet.scenario
    times = (np.array(uav.stamps) - fleet.legs[0][0]) * 1e-9
    flown = times >= 0.0
    split = next(leg for leg in made.legs if leg.name == "away")
    during = np.linspace(split.begin_s, split.due_s, 101)
    path = agent_config(made, made.leader.id).trajectory
    beside = places_beside_leader(made, uav_id, during)
    places = np.array([reference(path, t).position for t in during]) + beside
    own = np.array(uav.odometry)[flown, 0:3]
    return ball.distances(own, times[flown]), ball.distances(places, during)


def true_places(fleet):
    return np.array([uav.vehicle.flight.truth.position_enu for uav in fleet.uavs.values()])


def held_places(fleet):
    """The points at which the vehicles are told to be before the formation."""
    streams = [uav.bridge.stream for uav in fleet.uavs.values()]
    return np.array(
        [
            (one.climb._target if one._stream is Stream.CLIMB else one._hold).position
            for one in streams
        ]
    )


def rms(errors):
    """Root of the mean square distance of errors (..., 3)."""
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=-1))))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "gnss"), [("px4", "rtk"), ("arducopter", "quiet")])
def test_by_the_truth_a_fleet_holds_its_formation_as_its_vehicles_hold_a_point(kind, gnss):
    """Both errors contain those of the receivers; the autopilot's own position loop sets the measure."""
    made = scenario(kind, duration_s=17.0)
    fleet = MavlinkFleet(made, kind, gnss=gnss)
    fleet.airborne()
    held, formed, closest_m = [], [], []
    for _ in range(80):
        fleet.run(0.1)
        held.append(true_places(fleet) - held_places(fleet))
    fleet.form()
    offsets = np.array([made.offset(i) for i in fleet.uavs])
    path = agent_config(made, made.leader.id).trajectory
    while (flight_s := (fleet.now_ns - fleet.legs[0][0]) * 1e-9) < made.timing.duration_s:
        fleet.run(0.1)
        places = true_places(fleet)
        closest_m += [np.linalg.norm(a - b) for a, b in combinations(places, 2)]
        if flight_s > made.gains.formation.deadline_s:
            leader = reference(path, (fleet.now_ns - fleet.legs[0][0]) * 1e-9).position
            formed.append(places - (leader + offsets))
    found = verdict_on(fleet.recording())
    assert found.judged_by == "truth"
    assert found.verdict == "met" or gnss == "quiet"  # its receivers alone are off by more
    assert min(closest_m) > made.formation.uav_keep_out_m
    assert rms(formed) < 1.3 * rms(held), (rms(formed), rms(held))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "armed_s", "reason"),
    [
        # PX4 tells a companion nothing else
        ("refuse", 0.0, "its pre-arm check fails (not healthy: prearm check)"),
        ("deny", 9.0, "arming refused"),
    ],
)
def test_when_one_vehicle_refuses_to_arm_no_other_leaves_the_ground(fault, armed_s, reason):
    """The others stood armed for 27 s; now none arms, or where its checks had passed all are disarmed again soon."""
    fleet = MavlinkFleet(scenario(), count=3)
    inject(fleet.uavs[2].vehicle, "arming", fault, fleet.now_s)
    inject(fleet.uavs[3].vehicle, "takeoff", "detected", fleet.now_s)  # denies the plain disarm
    armed = []

    def over():
        armed.extend(fleet.now_s for uav in fleet.uavs.values() if uav.vehicle.armed)
        return all(uav.bridge.procedure.over for uav in fleet.uavs.values())

    fleet.run(90.0, until=over)
    fleet.run(2.0)
    assert (max(armed) - min(armed) if armed else 0.0) <= armed_s
    for uav in fleet.uavs.values():
        assert uav.step is Step.FAILED
        assert not uav.vehicle.armed
        assert not uav.vehicle.lifted
        assert uav.vehicle.flight.truth.position_enu[2] < 0.1
        assert "left behind" not in uav.bridge.procedure.fault
    assert reason in fleet.uavs[2].bridge.procedure.fault
    assert "bridge2" in fleet.uavs[1].bridge.procedure.fault


@pytest.mark.slow
@pytest.mark.parametrize("step", [Step.ARM, Step.ARMED, Step.TAKEOFF])
def test_when_a_uav_process_stops_while_its_vehicle_arms_all_are_down_within_20_s(step):
    kind = "arducopter"
    fleet = MavlinkFleet(scenario(kind), kind, count=2)
    fleet.run(90.0, until=lambda: fleet.uavs[2].step is step)
    fleet.uavs[2].alive = False
    fleet.run(20.0, until=lambda: not any(uav.vehicle.armed for uav in fleet.uavs.values()))
    fleet.run(5.0, until=lambda: all(uav.bridge.procedure.over for uav in fleet.uavs.values()))
    assert "bridge2" in fleet.uavs[1].bridge.procedure.fault


@pytest.mark.slow
def test_vehicles_arm_together_and_those_that_stand_close_climb_in_turns():
    """2 and 3 stand 0.73 m apart, and keep 0.5 m."""
    fleet = MavlinkFleet(scenario(), count=3)
    up = {}

    def heights():
        for uav in fleet.uavs.values():
            if uav.vehicle.lifted:
                up.setdefault(
                    uav.id,
                    {i: u.vehicle.flight.truth.position_enu[2] for i, u in fleet.uavs.items()},
                )
                assert all(u.vehicle.armed for u in fleet.uavs.values())
        return all(not u.bridge.procedure.awaited for u in fleet.uavs.values())

    fleet.run(90.0, until=heights)
    assert up[3][2] > 1.3
    assert up[1][2] < 0.5  # 1 stands far enough from both
    assert {uav.bridge.procedure.fault for uav in fleet.uavs.values()} == {""}


def test_vehicles_at_one_place_are_not_armed(tmp_path):
    path = tmp_path / "one_place.yaml"
    there = "".join(f"  - {{id: {i}, position_m: [{0.02 * i}, 1.1, 1]}}\n" for i in (1, 2, 3, 4))
    path.write_text(f"extends: experiment_4\nuavs:\n{there}")
    fleet = MavlinkFleet(load_scenario(str(path)).bridged(), count=2)
    fleet.run(90.0, until=lambda: all(u.bridge.procedure.over for u in fleet.uavs.values()))
    faults = [uav.bridge.procedure.fault for uav in fleet.uavs.values()]
    assert any("m from the vehicle of bridge" in fault for fault in faults)
    assert not any(uav.vehicle.armed or uav.vehicle.lifted for uav in fleet.uavs.values())


def test_plain_gnss_is_refused_by_the_scenario_for_rtk_before_anything_arms():
    fleet = MavlinkFleet(scenario(), gnss="plain", count=2)
    fleet.run(60.0, until=lambda: all(uav.step is Step.FAILED for uav in fleet.uavs.values()))
    for uav in fleet.uavs.values():
        assert not uav.vehicle.armed
    faults = [uav.bridge.procedure.fault for uav in fleet.uavs.values()]
    assert any("known to 0.45 m: expected at most 0.14 m" in fault for fault in faults), faults


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["px4", "arducopter"])
def test_plain_gnss_flies_the_scenario_that_is_made_for_it(kind):
    changes = {"mavlink.autopilot": AUTOPILOTS[kind], "timing.duration_s": 25}
    fleet = MavlinkFleet(load_scenario("field_gnss_4", changes).bridged(), kind, gnss="plain")
    fleet.airborne().form().run(25.5)
    fleet.land()
    assert [uav.bridge.procedure.fault for uav in fleet.uavs.values()] == [""] * 4
    assert verdict_on(fleet.recording()).verdict == MET


def field_in_wind(tmp_path, kind, wind_m_s):
    """`field_gnss_4` in a steady wind and a drag of 0.3 1/s, behind stand-ins that take off against it."""
    path = tmp_path / "wind.yaml"
    path.write_text(
        "extends: field_gnss_4\nname: wind\ntiming: {duration_s: 25}\n"
        f"world: {{wind_m_s: [{wind_m_s}, 0, 0]}}\nplant: {{quadrotor: {{drag_1_s: 0.3}}}}\n"
        f"mavlink: {{autopilot: {AUTOPILOTS[kind]}}}\n"
    )
    return MavlinkFleet(load_scenario(str(path)).bridged(), kind, gnss="plain")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "wind_m_s", "worst_m"), [("arducopter", 14, 1.6), ("px4", 16, 3.1)]
)
def test_a_steady_wind_is_flown_as_the_page_for_the_field_says(tmp_path, kind, wind_m_s, worst_m):
    """It takes 23 of 30 degrees of tilt, and 4.8 of 5 m/s^2."""
    fleet = field_in_wind(tmp_path, kind, wind_m_s).airborne().form().run(25.5).land()
    found = verdict_on(fleet.recording())
    assert found.verdict == MET
    assert max(uav.max_error_after_all_m for uav in found.uavs) < worst_m


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "wind_m_s"), [("arducopter", 16), ("px4", 19)])
def test_in_a_wind_beyond_the_limit_all_land_before_the_formation(tmp_path, kind, wind_m_s):
    fleet = field_in_wind(tmp_path, kind, wind_m_s)
    fleet.run(90.0, until=lambda: all(uav.bridge.procedure.over for uav in fleet.uavs.values()))
    assert not any(uav.vehicle.armed for uav in fleet.uavs.values())
    faults = [uav.bridge.procedure.fault for uav in fleet.uavs.values()]
    assert any("m off its start before the formation" in fault for fault in faults), faults


@pytest.mark.parametrize("count", [1, 2])
def test_a_vehicle_far_from_its_start_is_not_armed(count):
    """Also when it is the last to be ready: then it passes several steps at once."""
    fleet = MavlinkFleet(scenario(), count=count)
    x, y, _ = fleet.uavs[count].bridge.placement.start
    fleet.uavs[count].bridge.placement.start = (x, y + 2.0, 0.0)
    fleet.run(90.0, until=lambda: all(u.bridge.procedure.over for u in fleet.uavs.values()))
    assert f"m from its start ({x:g}, {y + 2.0:g}) m: expected at most 1.0" in (
        fleet.uavs[count].bridge.procedure.fault
    )
    assert not any(uav.vehicle.lifted for uav in fleet.uavs.values())


@pytest.mark.slow
def test_a_jump_of_one_position_makes_all_hold_apart_by_height_and_land():
    fleet = MavlinkFleet(scenario(), count=3)
    fleet.airborne().form().run(4.0)
    inject(fleet.uavs[2].vehicle, "jump", "2.5", fleet.now_s)
    fleet.run(2.0, until=lambda: all(u.step is Step.APART for u in fleet.uavs.values()))
    fleet.run(20.0, until=lambda: any(u.step is Step.LAND for u in fleet.uavs.values()))
    heights = sorted(u.vehicle.flight.truth.position_enu[2] for u in fleet.uavs.values())
    assert min(b - a for a, b in pairwise(heights)) > 1.0, heights
    fleet.run(90.0, until=lambda: all(u.bridge.procedure.over for u in fleet.uavs.values()))
    faults = {i: uav.bridge.procedure.fault for i, uav in fleet.uavs.items()}
    assert "formation given up: its position jumped by 2.5 m" in faults[2]
    assert "formation given up: told by another bridge" in faults[1]
    assert not any(uav.vehicle.armed for uav in fleet.uavs.values())
    assert [uav.step for uav in fleet.uavs.values()] == [Step.DONE] * 3


@pytest.mark.slow
def test_after_an_abort_vehicles_take_off_again_and_go_on_with_a_later_leg():
    """As `ptnsbc mission start far` begins it, when all wait in the air."""
    kind = "arducopter"
    legs = [
        *MISSION["mission.legs"][:3],
        {"kind": "go_to", "name": "far", "position_m": [3, 2, 6], "over_s": 8},
        {"kind": "land", "over_s": 16},
    ]
    changes = {
        "mavlink.autopilot": AUTOPILOTS[kind],
        "timing.duration_s": 40.0,
        "mission.legs": legs,
    }
    made = load_scenario("take_off_4", {**MISSION, **changes, "world.obstacles": []}).bridged()
    fleet = MavlinkFleet(made, kind, gnss="perfect", count=2).airborne().form()
    fleet.announce("mission 4", 0.5 + formed_s(made.legs, 4))
    fleet.run(60.0, until=lambda: all(uav.step is Step.DONE for uav in fleet.uavs.values()))
    assert {uav.bridge.procedure.fault for uav in fleet.uavs.values()} == {""}
    leader = np.array(fleet.uavs[made.leader.id].odometry)
    assert np.linalg.norm(leader[-1, 0:2] - (3.0, 2.0)) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["px4", "arducopter"])
def test_one_vehicle_goes_home_and_the_others_fly_on_clear_of_it(kind):
    """At a height within the formation, which is the worst one."""
    fleet = MavlinkFleet(scenario(kind, duration_s=60.0), kind, count=3)
    fleet.set_parameter("RTL_RETURN_ALT" if kind == "px4" else "RTL_ALT_M", 4.0)
    fleet.airborne().form().run(4.0)
    home, *others = fleet.uavs[3], fleet.uavs[1], fleet.uavs[2]
    home.inputs.take(Order("return"))
    nearest = []

    def landed():
        places = [uav.vehicle.flight.truth.position_enu for uav in (home, *others)]
        nearest.append(min(float(np.linalg.norm(places[0] - other)) for other in places[1:]))
        assert {uav.step for uav in others} == {Step.FLY}
        return home.step is Step.DONE

    fleet.run(60.0, until=landed)
    assert home.step is Step.DONE, home.step
    assert min(nearest) > 0.5
    fleet.land()
    assert [uav.step for uav in fleet.uavs.values()] == [Step.DONE] * 3


def off_place_m(fleet):
    """The way from the follower's place beside the reference of the leader to the follower [m, ENU]."""
    made = fleet.scenario
    t = (fleet.now_ns - fleet.legs[0][0]) * 1e-9
    leader = reference(agent_config(made, made.leader.id).trajectory, t).position
    return fleet.uavs[2].vehicle.flight.truth.position_enu - leader - made.offset(2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("functions", "expected"),
    [(OWN_LAW, [0.0, 0.0, ABOVE_M]), (OWN_TASK, [0.0, 0.0, 0.0])],
    ids=["law_and_trajectory", "task_and_controller"],
)
def test_a_follower_is_where_functions_of_the_user_lead_it_by_the_deadline(
    tmp_path, functions, expected
):
    (tmp_path / "mine.py").write_text(OWN_FUNCTIONS, "utf-8")
    file = tmp_path / "mine.yaml"
    file.write_text(OWN_SCENARIO + functions, "utf-8")
    fleet = MavlinkFleet(load_scenario(file).bridged(), "px4", gnss="perfect", count=2)
    fleet.airborne().form().run(10.5)
    assert {uav.bridge.procedure.fault for uav in fleet.uavs.values()} == {""}, fleet.report()
    np.testing.assert_allclose(off_place_m(fleet), expected, atol=0.1)


STREAM = {
    "communication.tree": {2: 1, 3: 1, 4: 1},
    "leader.trajectory": {
        "kind": "stream",
        "position_m": [0, 0, 3],
        "low_m": [-6, -6, 1],
        "high_m": [6, 6, 6],
        "speed_m_s": 1.5,
        "acceleration_m_s2": 1.2,
        "silent_s": 1.0,
    },
}


@pytest.mark.slow
def test_a_stream_of_setpoints_is_followed_and_ends_in_a_hover():
    made = scenario(duration_s=60.0, **STREAM)
    fleet = MavlinkFleet(made, "px4", gnss="perfect", count=2)
    fleet.airborne().form().run(11.0)
    began, speed = fleet.now_s, np.array([0.6, 0.3, 0.1])

    def asked():
        return np.array([0.0, 0.0, 3.0]) + (fleet.now_s - began) * speed

    while fleet.now_s - began < 8.0:
        odometry = np.zeros(13)
        odometry[0:3], odometry[6], odometry[7:10] = asked(), 1.0, speed
        fleet.tell_setpoint(odometry)
        fleet.run(0.2)
    leader, follower = (uav.vehicle.flight for uav in fleet.uavs.values())
    np.testing.assert_allclose(leader.truth.position_enu, asked(), atol=0.15)
    np.testing.assert_allclose(follower.truth.position_enu - made.offset(2), asked(), atol=0.15)
    fleet.run(6.0)  # nobody tells it anything
    rests = leader.truth.position_enu.copy()
    fleet.run(3.0)
    assert np.linalg.norm(leader.truth.position_enu - rests) < 0.05
    assert np.linalg.norm(follower.truth.position_enu - made.offset(2) - rests) < 0.15
    assert [uav.step for uav in fleet.uavs.values()] == [Step.FLY] * 2
    assert {uav.bridge.procedure.fault for uav in fleet.uavs.values()} == {""}, fleet.report()
