"""A bridge and the stand-in of its vehicle: every fault of the one and the other, on a clock of the tests."""

from functools import cache

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_fleet import AUTOPILOTS, BASE_NS, START_S, MavlinkFleet, scenario

from ptnsbc_autopilot.fault_lines import inject
from ptnsbc_autopilot.server import Codec
from ptnsbc_autopilot.vehicle import COMPANION
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.emergency import Order
from ptnsbc_sim.scenario import load_scenario


@pytest.mark.parametrize("kind", ["px4", pytest.param("arducopter", marks=pytest.mark.slow)])
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


@cache
def in_formation():
    """One flying vehicle of four, in formation with itself; whoever goes on takes a copy."""
    fleet = MavlinkFleet(scenario(), count=1)
    fleet.set_parameter("COM_OBL_RC_ACT", 5)
    return fleet.airborne().form().run(2.0).forget()


def one():
    """A copy of that flight, and its vehicle."""
    fleet = in_formation().copied()
    return fleet, fleet.uavs[1]


def test_a_copy_of_a_flight_goes_on_as_the_flight():
    fleet, uav = one()
    other = fleet.copied().run(0.5).uavs[1]
    assert len(other.odometry) > len(uav.odometry)  # it has time and vehicle of its own
    fleet.run(0.5)
    assert np.array(other.odometry).tobytes() == np.array(uav.odometry).tobytes()
    assert other.setpoints[-1][1].to_dict() == uav.setpoints[-1][1].to_dict()


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


def test_a_bridge_that_stood_still_has_its_vehicle_back_from_the_failsafe():
    fleet, uav = one()
    uav.bridge_alive = False
    fleet.run(1.8)
    assert uav.vehicle.mode_name == "HOLD"
    uav.bridge_alive = True
    until(fleet, uav, Step.FAILSAFE, 0.1)
    until(fleet, uav, Step.FLY)
    fleet.run(3.0)
    assert uav.step is Step.FLY
    assert uav.vehicle.mode_name == "OFFBOARD"
    assert uav.bridge.procedure.fault == (
        "no setpoints: this bridge stood still for 1.8 s: give its computer less work"
    )


def left_alone(*faults, seconds=4.0):
    """A vehicle whose bridge has died, after its failsafe has acted, and another bridge that begins."""
    fleet, uav = one()
    frame, uav.bridge_alive = uav.bridge.state_publisher.world.frame, False
    fleet.run(4.0)
    assert (uav.vehicle.mode_name, uav.vehicle.armed) == ("HOLD", True)
    for mode in faults:
        inject(uav.vehicle, "mode", mode, fleet.now_s)
    fleet.run(seconds - 4.0)
    uav.begin_bridge(frame)
    return fleet, uav


def test_another_bridge_holds_the_vehicle_of_one_that_died_and_brings_it_back():
    fleet, uav = left_alone()
    origins = []
    uav.ports.origin = origins.append
    frame = uav.bridge.state_publisher.world.frame
    held = uav.vehicle.flight.truth.position_enu.copy()
    until(fleet, uav, Step.FAILSAFE)
    fleet.run(10.0, until=lambda: uav.vehicle.mode_name == "OFFBOARD")  # by itself, on the stream
    np.testing.assert_allclose(uav.vehicle.flight.truth.position_enu, held, atol=0.15)
    until(fleet, uav, Step.FLY)
    assert fleet.run(5.0).leader_error_m() < 0.15  # in the world of before
    assert uav.bridge.state_publisher.world.frame == frame
    assert origins == []  # the bag has the place of the leader from the bridge before
    fleet.land()
    assert (uav.step, uav.vehicle.armed) == (Step.DONE, False)
    assert uav.bridge.procedure.fault == "its bridge died, and another one took over"


@pytest.mark.parametrize(
    ("mode", "step"),
    [
        ("POSCTL", Step.YIELDED),  # a pilot has it
        ("HOLD", Step.YIELDED),  # a pilot wants it there
        ("LAND", Step.DONE),
    ],
)
def test_another_bridge_leaves_a_vehicle_to_the_pilot_who_took_it_meanwhile(mode, step):
    fleet, uav = left_alone(mode)
    until(fleet, uav, step, 60.0)
    assert uav.bridge.procedure.in_pilots_hands == (step is Step.YIELDED)
    assert uav.vehicle.armed == (step is Step.YIELDED)


def test_a_vehicle_that_came_down_without_its_bridge_does_not_take_off_again():
    fleet, uav = left_alone("LAND", seconds=60.0)
    assert not uav.vehicle.armed
    until(fleet, uav, Step.FAILED)
    assert uav.bridge.procedure.fault == "it came down while its bridge was dead"


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


@pytest.mark.parametrize(
    ("fault", "reason"),
    [("refuse", "its pre-arm check fails (not healthy: "), ("deny", "arming refused (arm: ")],
)
def test_arming_refused_by_the_vehicle(fault, reason):
    fleet = MavlinkFleet(scenario(), count=1)
    uav = fleet.uavs[1]
    inject(uav.vehicle, "arming", fault, fleet.now_s)
    until(fleet, uav, Step.FAILED, 90.0)
    assert reason in uav.bridge.procedure.fault


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
    fleet.run(6.0)
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


@pytest.mark.slow
def test_a_low_battery_lands_this_vehicle():
    fleet, uav = one()
    inject(uav.vehicle, "battery", "0.15", fleet.now_s)
    until(fleet, uav, Step.LAND)
    until(fleet, uav, Step.DONE, 60.0)
    assert "battery at 1" in uav.bridge.procedure.fault


HIGH = {"leader.trajectory.centre_m": [0, 0, 8], "mavlink.takeoff_height_m": 3.0}


def test_a_fence_in_the_way_lands_it_no_farther_than_it_must():
    fleet = MavlinkFleet(scenario(**HIGH), count=1)
    fleet.airborne()
    uav = fleet.uavs[1]
    uav.bridge.stream.guard.high[2] = 5.0  # the leader's path is at 8 m
    fleet.form().run(12.0)
    assert uav.bridge.stream.guard.clamped["fence"] > 100
    assert max(odometry[2] for odometry in uav.odometry) < 5.3
    uav.bridge.stream.guard.high[2] = (
        4.2  # and now it is outside, within the slack: it is pushed back
    )
    fleet.run(8.0)
    assert uav.step is Step.FLY
    assert uav.odometry[-1][2] < 4.4
    uav.bridge.stream.guard.high[2] = 2.5  # and now it is farther outside
    until(fleet, uav, Step.LAND)
    assert "outside the geofence: z = " in uav.bridge.procedure.fault


def test_by_attitude_a_vehicle_at_the_fence_is_held_at_the_nearest_place_inside():
    """A wrench cannot be cut down: outside, or soon there, a position inside the fence takes its place."""
    made = scenario(setpoint="attitude", **HIGH)
    fleet = MavlinkFleet(made, gnss="perfect", count=1)
    uav = fleet.airborne().uavs[1]
    uav.bridge.stream.guard.high[2] = 4.0  # the leader's path is at 8 m
    fleet.form().run(1.0)
    assert uav.setpoints[-1][1].get_type() == "SET_ATTITUDE_TARGET"
    fleet.run(6.0)
    late = [message for _, message in uav.setpoints[-100:]]
    held = [one for one in late if one.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    assert len(held) > 50
    assert max(-one.z for one in held) == pytest.approx(4.0, abs=0.03)
    assert max(odometry[2] for odometry in uav.odometry) < 4.2
    assert uav.step is Step.FLY
    uav.bridge.stream.guard.high[2] = 2.5  # and now it is farther outside than the slack
    until(fleet, uav, Step.LAND)
    assert "outside the geofence: z = " in uav.bridge.procedure.fault


def test_the_planner_is_slowed_down_to_the_vehicle():
    fleet = MavlinkFleet(scenario(), count=1)
    fleet.set_parameter("MPC_XY_VEL_MAX", 0.4)
    fleet.airborne().form().run(4.0)
    limits = fleet.uavs[1].controller.config.filter
    assert limits.max_speed == pytest.approx(0.4)
    sent = [m for _, m in fleet.uavs[1].setpoints if m.get_type().startswith("SET_POSITION")]
    assert max((m.vx**2 + m.vy**2) ** 0.5 for m in sent) <= 0.4 + 1e-6


def test_angles_are_decoded_only_while_no_quaternions_come():
    fleet, uav = one()
    angles, odometry = mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_ODOMETRY
    assert uav.link.ignored == {angles, odometry}
    quaternions = mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
    uav.vehicle.streams[COMPANION].set_interval(quaternions, -1.0, fleet.now_s)
    fleet.run(3.0)
    assert uav.link.ignored == {odometry}  # positions still come
    assert (uav.step, uav.bridge.procedure.fault) == (Step.FLY, ""), fleet.report()
    assert published_last_s(fleet, uav) < 0.1


@pytest.mark.slow
def test_stop_and_kill_in_flight():
    fleet, uav = one()
    uav.inputs.take(Order("land"))
    until(fleet, uav, Step.DONE, 60.0)
    assert uav.bridge.procedure.fault == ""
    fleet, uav = one()
    uav.inputs.take(Order("kill"))
    until(fleet, uav, Step.FAILED, 3.0)
    assert not uav.vehicle.armed


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


@pytest.mark.parametrize(
    ("setpoint", "says"),
    [
        ("attitude", "gains.force.kappa_1_s = 12: the vehicle would swing, "),
        ("position_velocity", "gains.formation.kappa_1_s is not compared with the vehicle"),
    ],
)
def test_by_the_other_setpoints_gains_are_judged_by_the_link_or_the_bridge_says_that_they_are_not(
    setpoint, says
):
    """12 1/s by attitude swings this stand-in until its bridge gives the formation up; 4 1/s are flown."""
    gains = {**load_scenario("experiment_4").mavlink.overrides, "gains.force.kappa_1_s": 12.0}
    made = scenario(setpoint=setpoint, **{"mavlink.overrides": gains})
    fleet = MavlinkFleet(made, count=1)
    uav = fleet.uavs[1]
    fleet.run(60.0, until=lambda: uav.bridge.procedure.over or uav.vehicle.armed)
    assert any(says in line for line in uav.lines)
    assert uav.vehicle.armed == (setpoint == "position_velocity")
    assert uav.bridge.procedure.fault.startswith("not armed: gains.force") == (
        setpoint == "attitude"
    )


def test_a_vehicle_that_comes_too_near_ends_the_formation():
    fleet, uav = one()
    place = uav.odometry[-1][0:3]

    def come(distance_m):
        odometry = np.zeros(13)
        odometry[0:3], odometry[6] = place + np.array([distance_m, 0.0, 0.0]), 1.0
        uav.near_objects.on_odometry(3, fleet.now_s, odometry)

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


def test_a_sensor_that_fails_in_flight_ends_the_formation():
    fleet, uav = one()
    inject(uav.vehicle, "unhealthy", "accelerometer", fleet.now_s)
    until(fleet, uav, Step.APART, 4.0)
    assert uav.bridge.procedure.fault == "formation given up: failed on board: 3d accel"


def test_a_uav_process_that_is_late_half_of_the_time_ends_the_formation():
    fleet, uav = one()
    for _ in range(20):
        uav.alive = False
        fleet.run(0.24)
        uav.alive = True
        fleet.run(0.02)
        if uav.step is Step.APART:
            break
    assert "formation given up: setpoints late for 5" in uav.bridge.procedure.fault
    assert "give the computers of UAV process and bridge less work" in uav.bridge.procedure.fault


def test_a_critical_text_counts_in_flight_and_an_old_one_does_not():
    fleet, uav = one()
    uav.bridge.vehicle.alarm = ("EKF variance", fleet.now_s - 1.5)
    fleet.run(0.5)
    assert uav.step is Step.FLY
    text = mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, b"EKF variance")
    uav.wire.put(uav.codec.encode(text))
    until(fleet, uav, Step.APART, 1.0)
    assert uav.bridge.procedure.fault == "formation given up: the vehicle says: EKF variance"


@pytest.mark.parametrize(
    ("kind", "setpoint", "wind_m_s"), [("px4", "velocity", 7), ("arducopter", "attitude", 29)]
)
def test_a_gale_that_carries_a_vehicle_off_ends_the_formation(kind, setpoint, wind_m_s):
    """Its tilt is at its limit, and its planner wants it back; nobody waits until it runs at `abort.away_m_s`."""
    made = scenario(kind, setpoint, **{"mavlink.geofence": {"radius_m": 60.0}})
    fleet = MavlinkFleet(made, kind, gnss="perfect", count=1)
    fleet.set_parameter("GUID_OPTIONS", 8)
    uav = fleet.airborne().form().run(2.0).uavs[1]
    inject(uav.vehicle, "wind", str(wind_m_s), fleet.now_s)
    until(fleet, uav, Step.APART, 8.0)
    assert "its error grows: for 3 s it flies away from its place" in uav.bridge.procedure.fault


def test_the_operators_stop_lands_a_vehicle_that_holds_apart():
    fleet, uav = one()
    uav.inputs.take(Order("apart"))
    until(fleet, uav, Step.APART, 1.0)
    uav.inputs.take(Order("land"))
    until(fleet, uav, Step.LAND, 1.0)


@pytest.mark.parametrize("kind", ["px4", pytest.param("arducopter", marks=pytest.mark.slow)])
def test_told_to_return_a_vehicle_comes_home_by_its_own_mode(kind):
    if kind == "px4":
        fleet, uav = one()
    else:
        fleet = MavlinkFleet(scenario(kind), kind, count=1).airborne().form().run(2.0)
        uav = fleet.uavs[1]
    fleet.set_parameter("RTL_RETURN_ALT" if kind == "px4" else "RTL_ALT_M", 5.0)
    uav.inputs.take(Order("return"))
    until(fleet, uav, Step.RETURN, 4.0)
    assert uav.bridge.fate.startswith("it returns by itself at RTL_")
    until(fleet, uav, Step.DONE, 60.0)
    away = uav.vehicle.flight.truth.position_enu - uav.vehicle.home_local_enu
    assert np.linalg.norm(away) < 2.0


def test_a_generic_vehicle_is_told_nothing_of_a_return():
    fleet = MavlinkFleet(scenario("stm32", "attitude"), "stm32", count=1).airborne()
    fleet.uavs[1].inputs.take(Order("return"))
    fleet.run(2.0)
    assert fleet.uavs[1].step is Step.AIRBORNE
