"""Vehicles behind drivers in place of MAVLink: one by one, and a fleet of them, on a clock of the tests."""

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from ros_fleet import RosFleet

from ptnsbc_io.mavlink.autopilots import AUTOPILOTS
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_io.mavlink.setpoints import SetpointMessages
from ptnsbc_nodes.bridge.commands import Commands
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest, Step
from ptnsbc_nodes.bridge.ros_vehicle.link import RosLink
from ptnsbc_nodes.bridge.vehicle_monitor import VehicleMonitor
from ptnsbc_nodes.emergency import Order
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.verdict import verdict_on

ROS = AUTOPILOTS["ros"]
TILTED = np.array([0.1, -0.2, 0.3, 0.927])


class OneLink(RosLink):
    error = None

    def __init__(self, steady_s):
        super().__init__(steady_s)
        self.setpoints, self.requests, self.there = [], [], True

    def fly(self, position, velocity, acceleration, yaw):
        self.setpoints.append((position, velocity, acceleration, yaw))

    def request(self, request):
        if self.error is not None:
            raise self.error
        self.requests.append(request)

    def alive(self):
        return self.there


@pytest.fixture
def clock():
    return [100.0]


@pytest.fixture
def link(clock):
    return OneLink(lambda: clock[0])


def told(link, now_s=100.0):
    return {message.get_type(): message for message in link.poll(now_s)}


def test_a_pose_is_the_state_that_a_bridge_knows(link, clock):
    vehicle = VehicleMonitor(ROS)
    turned = TILTED / np.linalg.norm(TILTED)
    position, velocity, rates = np.array([1.0, 2, 3]), np.array([0.4, 0.5, 0.6]), np.ones(3)
    clock[0] += 0.5
    link.pose(0, position, turned, velocity, rates)
    state = vehicle.on_message(told(link)["ODOMETRY"], clock[0])
    assert state.boot_s == pytest.approx(0.5)
    expected = np.concatenate((position, turned, velocity, rates))
    assert state.odometry == pytest.approx(expected)


def test_the_velocity_of_positions_is_estimated_and_turned_into_the_body(link, clock):
    vehicle, half = VehicleMonitor(ROS), np.sqrt(0.5)
    for k in range(100):
        clock[0] += 0.01
        link.pose(0, np.array([0.01 * k, 0.0, 0.0]), np.array([0.0, 0.0, half, half]))
        state = vehicle.on_message(told(link)["ODOMETRY"], clock[0])
    assert state.odometry[7:10] == pytest.approx([0.0, -1.0, 0.0], abs=1e-6)


def test_stamps_of_another_clock_count_from_the_fastest_message(link, clock):
    delays_s = [0.05, 0.02, 0.03]
    for k, delay_s in enumerate(delays_s):
        clock[0] = 100.0 + 0.1 * k + delay_s
        link.pose(5_000_000_000 + 100_000_000 * k, np.zeros(3), TILTED)
    *_, message = (m for m in link.poll(clock[0]) if m.get_type() == "ODOMETRY")
    assert clock[0] - 100.0 - 1e-6 * message.time_usec == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("position", "quaternion"),
    [((np.nan, 0, 0), TILTED), ((0, 0, np.inf), TILTED), ((0, 0, 0), np.zeros(4))],
)
def test_a_pose_that_is_none_is_refused_and_said(link, clock, position, quaternion):
    link.source = "/red/pose"
    link.pose(0, np.array(position, float), quaternion)
    clock[0] += 0.6
    link.pose(0, np.array(position, float), quaternion)
    told(link, clock[0])
    assert link.counts == {"/red/pose": 2}
    assert link.missing.startswith("no position from the vehicle: /red/pose: [")
    for _ in range(9):  # the estimate of the velocity has not seen it
        clock[0] += 0.02
        link.pose(0, np.ones(3), TILTED)
    told(link, clock[0])
    assert (link.missing, link.velocity.tolist()) == ("", [0, 0, 0])
    clock[0] += 0.6
    told(link, clock[0])
    assert link.missing == "no position from the vehicle: nothing on /red/pose"


@pytest.mark.parametrize(
    ("rate_hz", "said"), [(30, ""), (5, "5.0 poses a second: expected 20 or more")]
)
def test_too_few_poses_keep_it_from_being_armed_and_not_from_flying(link, clock, rate_hz, said):
    for _ in range(80):
        clock[0] += 1 / rate_hz
        link.pose(0, np.zeros(3), TILTED)
        told(link, clock[0])
    assert link.missing == said
    link.done(CommandRequest.ARM)
    for _ in range(2):
        told(link, clock[0])
    assert link.missing == ""


def test_it_tells_of_every_change_at_once_and_once_a_second(link):
    vehicle = VehicleMonitor(ROS)

    def look(now_s):
        messages = list(link.poll(now_s))
        for message in messages:
            vehicle.on_message(message, now_s)
        return len(messages)

    assert (look(100.0), look(100.5), look(101.0)) == (2, 0, 2)
    assert (vehicle.armed, vehicle.landed, vehicle.wrong_vehicle) == (False, True, "")
    for request in (CommandRequest.OWN_MODE, CommandRequest.ARM):
        link.done(request)
    assert look(101.1) == 2
    assert (vehicle.mode, vehicle.armed, vehicle.landed) == (FlightMode.OWN, True, False)
    link.report(mode=FlightMode.OTHER, landed=True)
    assert look(101.2) == 2
    assert (vehicle.mode, vehicle.landed) == (FlightMode.OTHER, True)
    link.there = False
    assert look(110.0) == 0


def test_a_vehicle_that_was_told_to_land_is_down_when_it_is_low_and_still(link):
    link.pose(0, np.array([0.0, 0.0, 0.3]), TILTED)
    link.done(CommandRequest.ARM)
    assert not link.down
    link.done(CommandRequest.LAND)
    link.pose(0, np.array([0.0, 0.0, 0.4]), TILTED, np.array([0.0, 0.0, -0.5]), np.zeros(3))
    assert not link.down
    link.pose(0, np.array([0.0, 0.0, 0.35]), TILTED, np.zeros(3), np.zeros(3))
    assert link.down


def test_requests_and_setpoints_reach_the_driver(link):
    commands = Commands(ROS, 1)
    for request in CommandRequest:
        link.command(request, commands.message(request, 2.0))
    assert link.requests == [r for r in CommandRequest if r is not CommandRequest.CHECK]
    up = np.array([1.0, 2.0, 3.0])
    link.send(SetpointMessages(ROS, 1).position_target(0.0, 0.3, velocity=up, acceleration=-up))
    ((position, velocity, acceleration, yaw),) = link.setpoints
    assert position is None
    assert (velocity.tolist(), acceleration.tolist()) == ([1, 2, 3], [-1, -2, -3])
    assert yaw == pytest.approx(0.3)


def test_no_setpoint_takes_a_vehicle_out_of_its_landing(link):
    link.done(CommandRequest.LAND)
    assert link.send(SetpointMessages(ROS, 1).position_target(0.0, 0.3, velocity=np.zeros(3)))
    assert link.setpoints == []


def test_the_clock_of_its_reports_is_ours(link, clock):
    clock[0] = 107.0
    link.send(mavlink.MAVLink_timesync_message(0, 107_000_000_000))
    answer = told(link)["TIMESYNC"]
    assert (answer.tc1, answer.ts1) == (7_000_000_000, 107_000_000_000)


def test_an_error_of_a_driver_is_an_alarm_and_ends_nothing(link):
    link.error = ZeroDivisionError("float division by zero")
    for _ in range(2):
        assert link.command(CommandRequest.LAND, None) is False
    *_, text = (m for m in link.poll(100.0) if m.get_type() == "STATUSTEXT")
    vehicle = VehicleMonitor(ROS)
    vehicle.on_message(text, 100.0)
    assert vehicle.alarm == ("OneLink: ZeroDivisionError: float division by zero", 100.0)


def fleet(**changes):
    return RosFleet(load_scenario("lab_4", changes).bridged(ros=True))


@pytest.fixture(scope="module")
def aloft():
    made = fleet(**{"timing.duration_s": 10.0}).airborne().form()
    return made.run(7.0)


@pytest.fixture
def flying(aloft):
    return aloft.copied()


@pytest.mark.slow
def test_four_vehicles_form_by_the_deadline_line_up_and_land():
    made = fleet().airborne().form().run(14.0)
    assert {uav.step for uav in made.uavs.values()} == {Step.FLY}, made.report()
    made.run(40.0, until=lambda: all(uav.bridge.procedure.over for uav in made.uavs.values()))
    assert {uav.bridge.procedure.fault for uav in made.uavs.values()} == {""}
    assert [uav.step for uav in made.uavs.values()] == [Step.DONE] * 4
    found = verdict_on(made.recording())
    assert {leg.kind: leg.verdict for leg in found.mission} == {"form": "met", "change": "met"}
    assert min(pair.distance_m for pair in found.separations) > 0.5
    asked = ["own mode", "arm", "take off", "land", "disarm"]
    for uav in made.uavs.values():
        assert list(dict.fromkeys(request.value for request in uav.mass.requests)) == asked


def test_a_pose_that_stops_ends_the_setpoints_and_the_vehicle_is_told_to_land(flying):
    victim = flying.uavs[3]
    victim.mass.told = False
    flying.run(1.0, until=lambda: victim.step is Step.FAILSAFE)
    assert "no position from the vehicle: nothing on" in victim.bridge.procedure.fault
    before = victim.mass.setpoints
    flying.run(2.0, until=lambda: victim.step is Step.LAND)
    assert victim.mass.setpoints == before
    flying.run(0.1)
    assert victim.mass.requests[-1] is CommandRequest.LAND


def test_an_order_to_land_reaches_them_in_flight(flying):
    for uav in flying.uavs.values():
        uav.inputs.take(Order("land"))
    done = lambda: all(u.bridge.procedure.over for u in flying.uavs.values())  # noqa: E731
    flying.run(20.0, until=done)
    assert {uav.step for uav in flying.uavs.values()} == {Step.DONE}
    assert all(uav.mass.position[2] < 0.1 for uav in flying.uavs.values())


def test_the_motors_of_a_vehicle_stop_by_its_service_or_it_says_why_not(flying):
    able, unable = flying.uavs[1], flying.uavs[2]
    unable.mass.refuses = (CommandRequest.KILL,)
    for uav in (able, unable):
        uav.inputs.take(Order("kill"))
    flying.run(1.0)
    assert (able.step, unable.step) == (Step.FAILED, Step.KILL)
    assert unable.bridge.vehicle.warning == "disarm in flight: not today"


def test_another_bridge_takes_over_the_vehicle_of_one_that_has_died(flying):
    victim = flying.uavs[2]
    frame = victim.bridge.state_publisher.world.frame
    victim.bridge_alive = False
    flying.run(0.6)
    victim.begin_bridge(frame)
    flying.run(5.0, until=lambda: victim.step is Step.FLY)
    assert "another one took over" in victim.bridge.procedure.fault


def test_a_vehicle_that_refuses_to_arm_keeps_the_others_on_the_ground():
    made = fleet()
    made.uavs[4].mass.refuses = (CommandRequest.ARM,)
    done = lambda: all(u.bridge.procedure.over for u in made.uavs.values())  # noqa: E731
    made.run(60.0, until=done)
    assert "arming refused (arm: not today)" in made.uavs[4].bridge.procedure.fault
    assert all(uav.mass.position[2] == 0.0 for uav in made.uavs.values())
