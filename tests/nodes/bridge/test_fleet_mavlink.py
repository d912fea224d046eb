"""Flights of stand-ins by bridges: whole fleets and every fault, on a clock of the tests."""

from itertools import combinations, pairwise

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_fleet import BASE_NS, START_S, MavlinkFleet

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_io.mavlink.autopilots import FlightMode
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.wire import OdometryTemplate
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.emergency.orders import Order
from ptnsbc_sim.autopilot.faults import inject
from ptnsbc_sim.autopilot.server import Codec
from ptnsbc_sim.autopilot.vehicle import COMPANION
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.verdict import verdict_on

AUTOPILOTS = {"px4": "px4", "arducopter": "ardupilot", "stm32": "generic"}


def scenario(kind="px4", setpoint="velocity", duration_s=12.0, **overrides):
    changes = {
        "timing.duration_s": duration_s,
        "mavlink.autopilot": AUTOPILOTS[kind],
        "mavlink.setpoint": setpoint,
        **overrides,
    }
    if kind == "stm32":  # 4 1/s is too much for it, and it would say so before the formation
        settings = load_scenario("experiment_4").mavlink.overrides
        changes["mavlink.overrides"] = {**settings, "gains.force.kappa_1_s": 3.0}
    return load_scenario("experiment_4", changes).bridged()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "setpoint"),
    [
        ("px4", "velocity"),
        ("px4", "attitude"),
        ("arducopter", "velocity"),
        ("arducopter", "attitude"),
        ("stm32", "attitude"),
    ],
)
def test_four_vehicles_take_off_form_by_the_deadline_and_land(kind, setpoint):
    fleet = MavlinkFleet(scenario(kind, setpoint), kind, gnss="perfect", spread_m=30.0)
    fleet.set_parameter("GUID_OPTIONS", 8)
    fleet.airborne().form().run(12.6).land()
    assert [uav.step for uav in fleet.uavs.values()] == [Step.DONE] * 4, fleet.report()
    assert {uav.bridge.procedure.fault for uav in fleet.uavs.values()} == {""}
    assert not any(uav.vehicle.armed for uav in fleet.uavs.values())
    found = verdict_on(fleet.recording())
    assert found.verdict == "met", [(u.uav, u.reason) for u in found.uavs]
    assert min(pair.distance_m for pair in found.separations) > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["px4", "arducopter"])
def test_four_vehicles_fly_a_figure_of_eight_in_a_v_that_turns(kind):
    changes = {"mavlink.autopilot": AUTOPILOTS[kind], "timing.duration_s": 35.0}
    made = load_scenario("figure_eight_4", changes).bridged()
    fleet = MavlinkFleet(made, kind, gnss="perfect")
    fleet.set_parameter("GUID_OPTIONS", 8)
    fleet.airborne().form().run(35.6).land()
    assert {uav.bridge.procedure.fault for uav in fleet.uavs.values()} == {""}
    found = verdict_on(fleet.recording())
    assert found.verdict == "met", [(u.uav, u.reason) for u in found.uavs]
    assert max(one.max_error_after_all_m for one in found.uavs) < 0.15
    assert min(pair.distance_m for pair in found.separations) > 1.5


def true_places(fleet):
    return np.array([uav.vehicle.flight.truth_enu for uav in fleet.uavs.values()])


def rms(errors):
    """Root of the mean square distance of errors (..., 3)."""
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=-1))))


@pytest.mark.slow
@pytest.mark.parametrize("gnss", ["rtk", "quiet"])
@pytest.mark.parametrize("kind", ["px4", "arducopter"])
def test_by_the_truth_a_fleet_holds_its_formation_as_its_vehicles_hold_a_point(kind, gnss):
    """Both errors contain those of the receivers; the autopilot's own position loop sets the measure."""
    made = scenario(kind, duration_s=30.0)
    fleet = MavlinkFleet(made, kind, gnss=gnss)
    fleet.airborne()
    held, formed, closest_m = [], [], []
    for _ in range(200):
        fleet.run(0.1)
        points = [uav.bridge.stream._hold.position for uav in fleet.uavs.values()]
        held.append(true_places(fleet) - points)
    fleet.form()
    offsets = np.array([made.offset(i) for i in fleet.uavs])
    path = agent_config(made, made.leader_id).trajectory
    while (flight_s := (fleet.now_ns - fleet.legs[0][0]) * 1e-9) < 30.0:
        fleet.run(0.1)
        places = true_places(fleet)
        closest_m += [np.linalg.norm(a - b) for a, b in combinations(places, 2)]
        if flight_s > made.gains.formation.deadline_s:
            leader = reference(path, (fleet.now_ns - fleet.legs[0][0]) * 1e-9).position
            formed.append(places - (leader + offsets))
    found = verdict_on(fleet.recording())
    assert found.judged_by == "truth"
    assert found.verdict == "met" or gnss == "quiet"  # its receivers alone are off by more
    assert min(closest_m) > made.uav_keep_out_m
    assert rms(formed) < 1.3 * rms(held), (rms(formed), rms(held))


@pytest.mark.parametrize("kind", ["px4", "arducopter"])
def test_a_bridge_knows_how_its_vehicle_flies_the_velocities(kind):
    fleet = MavlinkFleet(scenario(kind, duration_s=30.0), kind, gnss="rtk", count=1)
    fleet.airborne().form().run(18.0)
    found = fleet.uavs[1].bridge.stream.following.found()
    assert found.gain == pytest.approx(1.0, abs=0.1)
    assert found.lag_s < 0.2
    drag = fleet.uavs[1].bridge.stream.drag.value
    assert drag == pytest.approx(fleet.uavs[1].vehicle.drag_1_s, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "setpoint"), [("px4", "position_velocity")])
def test_a_leader_alone_by_the_other_ways(kind, setpoint):
    fleet = MavlinkFleet(scenario(kind, setpoint), kind, gnss="perfect", count=1)
    fleet.airborne().form().run(12.6)
    assert fleet.leader_error_m() < 0.1
    fleet.land()
    assert fleet.uavs[1].bridge.procedure.fault == "", fleet.report()


def one(**overrides):
    """One flying vehicle of four, in formation with itself."""
    fleet = MavlinkFleet(scenario(**overrides), count=1)
    fleet.set_parameter("COM_OBL_RC_ACT", 5)
    fleet.airborne().form().run(2.0)
    return fleet, fleet.uavs[1]


def until(fleet, uav, step, seconds=10.0):
    fleet.run(seconds, until=lambda: uav.step is step)


def published_last_s(fleet, uav):
    """How long ago the formation received this vehicle's odometry."""
    return fleet.now_s - START_S - (uav.stamps[-1] - BASE_NS) * 1e-9


def test_setpoints_end_the_stream_ends_the_failsafe_acts_and_then_the_pilot():
    fleet, uav = one()
    stopped = fleet.now_s
    uav.alive = False
    until(fleet, uav, Step.FAILSAFE, 2.0)
    fleet.run(0.5)
    assert uav.setpoints[-1][0] - stopped <= 0.6
    fleet.run(3.0, until=lambda: uav.bridge.vehicle.mode is FlightMode.HOLD)  # PX4's own failsafe
    assert uav.lost == 1
    uav.alive = True  # PX4 returns to OFFBOARD by itself, without a request
    until(fleet, uav, Step.FLY)
    assert uav.bridge.vehicle.mode is FlightMode.OWN
    fleet.run(3.0)
    assert uav.step is Step.FLY
    taken = fleet.now_s
    inject(uav.vehicle, "mode", "POSCTL", fleet.now_s)
    until(fleet, uav, Step.YIELDED)
    fleet.run(3.0)
    assert uav.setpoints[-1][0] - taken < 1.6  # HEARTBEAT comes once a second
    assert "the pilot took over" in uav.bridge.procedure.fault
    assert published_last_s(fleet, uav) > 1.0
    assert fleet.now_s - uav.tracks[-1][0] < 0.1


def test_a_bridge_killed_leaves_the_vehicle_to_its_failsafe():
    fleet, uav = one()
    uav.bridge_alive = False
    fleet.run(3.0)
    assert uav.vehicle.mode_name not in ("OFFBOARD",)
    assert uav.vehicle.armed


def test_a_vehicle_that_is_rebooted_is_not_armed_again():
    fleet, uav = one()
    inject(uav.vehicle, "reboot", "", fleet.now_s)
    until(fleet, uav, Step.FAILED)
    assert "the vehicle rebooted in flight" in uav.bridge.procedure.fault
    assert not uav.vehicle.armed


def test_a_px4_that_lands_is_not_initialised_until_its_checks_pass_and_the_flight_is_done():
    fleet, uav = one()
    uav.inputs.take(Order("land"))
    until(fleet, uav, Step.DONE, 60.0)
    uav.bridge.leave()
    fleet.run(1.5)
    assert uav.bridge.procedure.fault == ""
    assert uav.vehicle.mode_name == "HOLD"  # in OFFBOARD it would arm at once the next time


def test_forged_packets_of_a_young_clock_do_not_end_the_flight_at_touchdown():
    fleet, uav = one()
    codec = Codec(uav.vehicle.system)
    for boot_ms in (1_500, 1_504):
        forged = mavlink.MAVLink_attitude_message(boot_ms, 0, 0, 0, 0, 0, 0)
        uav.wire.put(codec.encode(forged))
        fleet.run(0.005)
    fleet.run(3.0)
    uav.inputs.take(Order("land"))
    until(fleet, uav, Step.DONE, 60.0)
    assert uav.bridge.procedure.fault == ""


def test_arming_refused_by_the_vehicle():
    fleet = MavlinkFleet(scenario(), count=1)
    uav = fleet.uavs[1]
    inject(uav.vehicle, "arming", "refuse", fleet.now_s)
    until(fleet, uav, Step.FAILED, 90.0)
    assert "arming refused (arm: " in uav.bridge.procedure.fault


def test_gps_lost_in_flight():
    fleet, uav = one()
    inject(uav.vehicle, "gps", "off", fleet.now_s)
    until(fleet, uav, Step.FAILSAFE, 30.0)
    fleet.run(1.0)
    assert published_last_s(fleet, uav) > 0.9
    assert fleet.now_s - uav.setpoints[-1][0] > 0.9


def test_heartbeat_lost_and_found_again():
    fleet, uav = one()
    inject(uav.vehicle, "heartbeat", "off", fleet.now_s)
    until(fleet, uav, Step.FAILSAFE)
    assert "no heartbeat" in uav.bridge.procedure.fault
    assert uav.lost == 1
    inject(uav.vehicle, "heartbeat", "on", fleet.now_s)
    until(fleet, uav, Step.FLY, 15.0)


@pytest.mark.parametrize("jump_s", ["40", "-3"])
def test_the_vehicles_clock_jumps_and_the_flight_goes_on(jump_s):
    fleet, uav = one()
    inject(uav.vehicle, "clock", jump_s, fleet.now_s)
    fleet.run(10.0)
    assert uav.step is Step.FLY, fleet.report()
    assert published_last_s(fleet, uav) < 0.1
    for stamp, odometry in list(zip(uav.stamps, uav.odometry, strict=True))[-400:]:
        assert abs(odometry[0]) < 3.0, stamp


def test_a_second_vehicle_with_the_same_id_changes_nothing_in_flight():
    fleet, uav = one()
    inject(uav.vehicle, "duplicate", "on", fleet.now_s)
    fleet.run(3.0)
    assert uav.link.counts["other_address"] > 10
    assert uav.step is Step.FLY
    assert abs(uav.odometry[-1][1]) < 10.0  # the other is 50 m to the north


def test_a_second_vehicle_with_the_same_id_is_not_armed():
    fleet = MavlinkFleet(scenario(), count=1)
    uav = fleet.uavs[1]
    inject(uav.vehicle, "duplicate", "on", fleet.now_s)
    until(fleet, uav, Step.FAILED, 30.0)
    assert "two vehicles with this system id" in uav.bridge.procedure.fault
    assert not uav.vehicle.armed


def test_a_low_battery_lands_this_vehicle():
    fleet, uav = one()
    inject(uav.vehicle, "battery", "0.15", fleet.now_s)
    until(fleet, uav, Step.LAND)
    until(fleet, uav, Step.DONE, 60.0)
    assert "battery at 1" in uav.bridge.procedure.fault


def test_a_fence_in_the_way_lands_it_no_farther_than_it_must():
    fleet = MavlinkFleet(scenario(**{"mavlink.takeoff_height_m": 3.0}), count=1)
    fleet.airborne()
    uav = fleet.uavs[1]
    uav.bridge.stream.guard._high[2] = 5.0  # the leader's path is at 8 m
    fleet.form().run(12.0)
    assert uav.bridge.stream.guard.clamped["fence"] > 100
    assert max(odometry[2] for odometry in uav.odometry) < 5.3
    uav.bridge.stream.guard._high[2] = (
        4.2  # and now it is outside, within the slack: it is pushed back
    )
    fleet.run(8.0)
    assert uav.step is Step.FLY
    assert uav.odometry[-1][2] < 4.4
    uav.bridge.stream.guard._high[2] = 2.5  # and now it is farther outside
    until(fleet, uav, Step.LAND)
    assert "outside the geofence: z = " in uav.bridge.procedure.fault


def test_the_planner_is_slowed_down_to_the_vehicle():
    fleet = MavlinkFleet(scenario(), count=1)
    fleet.set_parameter("MPC_XY_VEL_MAX", 0.4)
    fleet.airborne().form().run(8.0)
    limits = fleet.uavs[1].controller.config.filter
    assert limits.max_speed == pytest.approx(0.4)
    sent = [m for _, m in fleet.uavs[1].setpoints if m.get_type().startswith("SET_POSITION")]
    assert max((m.vx**2 + m.vy**2) ** 0.5 for m in sent) <= 0.4 + 1e-6


def test_angles_are_decoded_only_while_no_quaternions_come():
    fleet, uav = one()
    angles = frozenset({mavlink.MAVLINK_MSG_ID_ATTITUDE})
    assert uav.link.ignored == angles
    quaternions = mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
    uav.vehicle.streams[COMPANION].set_interval(quaternions, -1.0, fleet.now_s)
    fleet.run(3.0)
    assert uav.link.ignored == frozenset()
    assert (uav.step, uav.bridge.procedure.fault) == (Step.FLY, ""), fleet.report()
    assert published_last_s(fleet, uav) < 0.1


def test_stop_and_kill_in_flight():
    fleet, uav = one()
    uav.inputs.take(Order("land"))
    until(fleet, uav, Step.DONE, 60.0)
    assert uav.bridge.procedure.fault == ""
    fleet, uav = one()
    uav.inputs.take(Order("kill"))
    until(fleet, uav, Step.FAILED, 3.0)
    assert not uav.vehicle.armed


def test_when_one_vehicle_refuses_to_arm_no_other_leaves_the_ground():
    fleet = MavlinkFleet(scenario(), count=3)
    inject(fleet.uavs[2].vehicle, "arming", "refuse", fleet.now_s)
    fleet.run(90.0, until=lambda: all(u.bridge.procedure.over for u in fleet.uavs.values()))
    fleet.run(2.0)
    for uav in fleet.uavs.values():
        assert uav.step is Step.FAILED
        assert not uav.vehicle.armed
        assert not uav.vehicle.lifted
        assert uav.vehicle.flight.truth_enu[2] < 0.1
    refused = fleet.uavs[2].bridge.procedure.fault
    assert "arming refused" in refused
    assert "not healthy: prearm check" in refused  # PX4 tells a companion nothing else
    assert "bridge2" in fleet.uavs[1].bridge.procedure.fault


def test_vehicles_arm_together_and_those_that_stand_close_climb_in_turns():
    """2 and 3 stand 0.73 m apart, and keep 0.5 m."""
    fleet = MavlinkFleet(scenario(), count=3)
    up = {}

    def heights():
        for uav in fleet.uavs.values():
            if uav.vehicle.lifted:
                up.setdefault(
                    uav.id, {i: u.vehicle.flight.truth_enu[2] for i, u in fleet.uavs.items()}
                )
                assert all(u.vehicle.armed for u in fleet.uavs.values())
        return all(u.bridge.procedure.ready for u in fleet.uavs.values())

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


@pytest.mark.parametrize(
    ("kind", "kappa", "ahead", "says"),
    [
        (
            "arducopter",
            2.2,
            "true",
            "kappa_1_s = 2.2: the vehicle's velocity loop would swing: expected at most 1.4",
        ),
        (
            "arducopter",
            1.2,
            "false",
            "expected at most 0.5, or mavlink.acceleration_feed_forward: true",
        ),
        ("px4", 2.2, "true", "expected at most 2.1"),
    ],
)
def test_gains_that_do_not_fit_the_vehicle_are_refused_with_the_number_that_would(
    tmp_path, kind, kappa, ahead, says
):
    path = tmp_path / "fast.yaml"
    path.write_text(
        "extends: experiment_4\n"
        f"mavlink: {{acceleration_feed_forward: {ahead}, autopilot: {AUTOPILOTS[kind]}, "
        f"overrides: {{gains.formation.kappa_1_s: {kappa}}}}}\n"
    )
    fleet = MavlinkFleet(load_scenario(str(path)).bridged(), kind, count=1)
    fleet.run(60.0, until=lambda: fleet.uavs[1].bridge.procedure.over)
    assert says in fleet.uavs[1].bridge.procedure.fault
    assert not fleet.uavs[1].vehicle.armed


def test_a_vehicle_far_from_its_start_is_not_armed():
    fleet = MavlinkFleet(scenario(), count=2)
    fleet.uavs[2].bridge._start = (-0.8, 2.2, 0.0)
    fleet.run(90.0, until=lambda: all(u.bridge.procedure.over for u in fleet.uavs.values()))
    assert "m from its start (-0.8, 2.2) m: expected at most 1.0" in (
        fleet.uavs[2].bridge.procedure.fault
    )
    assert not any(uav.vehicle.lifted for uav in fleet.uavs.values())


def test_a_jump_of_one_position_makes_all_hold_apart_by_height_and_land():
    fleet = MavlinkFleet(scenario(), count=3)
    fleet.airborne().form().run(4.0)
    inject(fleet.uavs[2].vehicle, "jump", "2.5", fleet.now_s)
    fleet.run(2.0, until=lambda: all(u.step is Step.APART for u in fleet.uavs.values()))
    fleet.run(20.0, until=lambda: any(u.step is Step.LAND for u in fleet.uavs.values()))
    heights = sorted(u.vehicle.flight.truth_enu[2] for u in fleet.uavs.values())
    assert min(b - a for a, b in pairwise(heights)) > 1.0, heights
    fleet.run(90.0, until=lambda: all(u.bridge.procedure.over for u in fleet.uavs.values()))
    faults = {i: uav.bridge.procedure.fault for i, uav in fleet.uavs.items()}
    assert "formation given up: its position jumped by 2.5 m" in faults[2]
    assert "formation given up: told by another bridge" in faults[1]
    assert not any(uav.vehicle.armed for uav in fleet.uavs.values())
    assert [uav.step for uav in fleet.uavs.values()] == [Step.DONE] * 3


def test_a_vehicle_that_comes_too_near_ends_the_formation():
    fleet, uav = one()
    place = uav.odometry[-1][0:3]
    intruder = OdometryTemplate("map", "x")

    def come(distance_m):
        odometry = np.zeros(13)
        odometry[0:3], odometry[6] = place + np.array([distance_m, 0.0, 0.0]), 1.0
        uav.near_objects.on_odometry(3, fleet.now_s, intruder.encode(BASE_NS, odometry))

    for _ in range(20):
        come(2.0)
        fleet.run(0.05)
    assert uav.step is Step.FLY
    for _ in range(20):
        place = uav.odometry[-1][0:3]
        come(0.1)
        fleet.run(0.05)
    assert uav.step is Step.APART
    assert "m from another vehicle" in uav.bridge.procedure.fault
    until(fleet, uav, Step.DONE, 90.0)


def test_the_operators_stop_lands_a_vehicle_that_holds_apart():
    fleet, uav = one()
    uav.inputs.take(Order("apart"))
    until(fleet, uav, Step.APART, 1.0)
    uav.inputs.take(Order("land"))
    until(fleet, uav, Step.LAND, 1.0)
