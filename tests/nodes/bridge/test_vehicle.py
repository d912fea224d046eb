"""What a vehicle tells: states in our frames, stale and broken ones refused, reboots and twins noticed."""

import math

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_wires import heartbeat

from ptnsbc_core.kinematics import velocity_enu, yaw_of
from ptnsbc_io.mavlink.autopilots import ARDUPILOT, PX4, FlightMode
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.frames import GeoPoint
from ptnsbc_io.mavlink.timesync import TimeSync
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.bridge.controller import ControllerSetpoints, PublishedOdometry, wanted_yaw
from ptnsbc_nodes.bridge.state_publisher import Clocks, StatePublisher
from ptnsbc_nodes.bridge.vehicle import Anchor, VehicleMonitor
from ptnsbc_nodes.bridge.world import WorldFrame
from ptnsbc_sim.scenario import load_scenario

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
PLACE = GeoPoint(47.397742, 8.545594, 488.0)


def position(boot_ms, xyz=(0, 0, 0), v=(0, 0, 0)):
    return mavlink.MAVLink_local_position_ned_message(boot_ms, *xyz, *v)


def attitude(boot_ms, yaw_ned=0.0):
    half = 0.5 * yaw_ned
    q = (math.cos(half), 0.0, 0.0, math.sin(half))
    return mavlink.MAVLink_attitude_quaternion_message(boot_ms, *q, 0.1, 0.2, 0.3)


def test_a_vehicle_facing_east_that_flies_north():
    vehicle = VehicleMonitor(PX4)
    vehicle.hear(attitude(1000, math.pi / 2), 0.0)
    sample = vehicle.hear(position(1010, (3, 4, -5), (2, 0, -1)), 0.0)
    assert sample.boot_s == 1.01
    assert sample.odometry[0:3] == pytest.approx([4, 3, 5])
    assert yaw_of(sample.odometry) == pytest.approx(0.0)
    assert velocity_enu(sample.odometry) == pytest.approx([0, 2, 1])
    assert sample.odometry[7:10] == pytest.approx([0, 2, 1])  # left of the nose, and up
    assert sample.odometry[10:13] == pytest.approx([0.1, -0.2, -0.3])


def test_attitude_as_angles_and_odometry_say_the_same():
    angles = mavlink.MAVLink_attitude_message(1000, 0.1, 0.2, 0.7, 0, 0, 0)
    vehicle = VehicleMonitor(PX4)
    vehicle.hear(angles, 0.0)
    one = vehicle.hear(position(1000, (1, 2, 3)), 0.0).odometry
    from ptnsbc_io.mavlink.frames import quaternion_from_euler_ned

    message = mavlink.MAVLink_odometry_message(
        1_000_000,
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_BODY_FRD,
        1,
        2,
        3,
        quaternion_from_euler_ned(0.1, 0.2, 0.7).tolist(),
        0,
        0,
        0,
        0,
        0,
        0,
        [0.0] * 21,
        [0.0] * 21,
    )
    other = VehicleMonitor(PX4).hear(message, 0.0).odometry
    assert other == pytest.approx(one)
    assert vehicle.hear(message, 0.0) is None  # one source at a time


@pytest.mark.parametrize(
    "broken",
    [
        position(1000, (math.nan, 0, 0)),
        position(1000, (0, 0, 0), (math.inf, 0, 0)),
        position(1000, (1e7, 0, 0)),
        position(1500),  # its attitude is half a second older
    ],
)
def test_states_that_cannot_be_flown_by(broken):
    vehicle = VehicleMonitor(PX4)
    vehicle.hear(attitude(1000), 0.0)
    assert vehicle.hear(broken, 0.0) is None


def test_a_quaternion_that_is_none():
    vehicle = VehicleMonitor(PX4)
    vehicle.hear(mavlink.MAVLink_attitude_quaternion_message(1, 0, 0, 0, 0, 0, 0, 0), 0.0)
    assert vehicle.hear(position(1), 0.0) is None
    assert vehicle.pose.invalid == 1


@pytest.mark.parametrize(
    ("autopilot", "custom", "mode"),
    [
        (PX4, 6 << 16, FlightMode.OWN),
        (PX4, 4 << 16 | 3 << 24, FlightMode.HOLD),
        (PX4, 4 << 16 | 6 << 24, FlightMode.LAND),
        (PX4, 3 << 16, FlightMode.OTHER),
        (ARDUPILOT, 4, FlightMode.OWN),
        (ARDUPILOT, 9, FlightMode.LAND),
        (ARDUPILOT, 5, FlightMode.OTHER),
    ],
)
def test_modes(autopilot, custom, mode):
    vehicle = VehicleMonitor(autopilot)
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | ARMED
    vehicle.hear(heartbeat(autopilot=autopilot.number, base_mode=base, custom_mode=custom), 1.0)
    assert (vehicle.mode, vehicle.armed, vehicle.stranger) == (mode, True, "")


def test_strangers_are_named():
    vehicle = VehicleMonitor(PX4)
    vehicle.hear(heartbeat(autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA), 1.0)
    assert vehicle.stranger == ("MAV_AUTOPILOT 3 (ardupilot): expected px4, see mavlink.autopilot")
    vehicle.hear(heartbeat(type=mavlink.MAV_TYPE_FIXED_WING), 1.0)
    assert "MAV_TYPE 1: expected a multirotor" in vehicle.stranger
    gimbal = VehicleMonitor(PX4)
    gimbal.hear(heartbeat(autopilot=mavlink.MAV_AUTOPILOT_INVALID), 1.0)
    assert gimbal.heartbeat_s is None


def test_a_reboot_is_time_that_went_back_and_a_vehicle_that_is_disarmed():
    vehicle = VehicleMonitor(PX4)
    vehicle.hear(heartbeat(base_mode=ARMED), 100.0)
    vehicle.hear(attitude(90_000), 100.0)
    vehicle.hear(attitude(1_500), 101.0)
    vehicle.hear(attitude(1_520), 101.02)
    assert not vehicle.rebooted  # armed as far as we know: its clock may have jumped
    vehicle.hear(heartbeat(), 101.5)
    assert vehicle.rebooted


def test_messages_that_were_held_up_are_no_reboot():
    vehicle = VehicleMonitor(PX4)
    for n in range(50):
        vehicle.hear(attitude(20_000 + 20 * n), 100.0 + 0.02 * n)
    for n in range(50, 250):  # a host that stood still for five seconds has them all at once
        vehicle.hear(attitude(20_000 + 20 * n), 106.0)
    for n in range(300, 350):
        vehicle.hear(attitude(20_000 + 20 * n), 100.0 + 0.02 * n)
    vehicle.hear(heartbeat(), 107.5)
    assert not vehicle.rebooted
    assert not vehicle.twin(107.5)


def test_two_vehicles_with_one_id_are_time_to_and_fro():
    vehicle = VehicleMonitor(PX4)
    for n in range(3):
        vehicle.hear(attitude(90_000 + n), 100.0 + 0.1 * n)
        assert not vehicle.twin(100.0 + 0.1 * n)
        vehicle.hear(attitude(5_000 + n), 100.05 + 0.1 * n)
    assert vehicle.twin(100.3)
    assert not vehicle.twin(110.0)


def test_gps_battery_landing_and_texts():
    vehicle = VehicleMonitor(PX4)

    def gps(fix):
        return mavlink.MAVLink_gps_raw_int_message(0, fix, 0, 0, 0, 0, 0, 0, 0, 9)

    vehicle.hear(gps(1), 0.0)
    assert not vehicle.fix_lost(9.0)  # never had one: it flies without
    vehicle.hear(gps(6), 10.0)
    vehicle.hear(gps(1), 11.0)
    assert not vehicle.fix_lost(11.5)
    assert vehicle.fix_lost(12.0)
    status = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, 15, 0, 0, 0, 0, 0, 0)
    vehicle.hear(status, 0.0)
    assert not vehicle.battery_below(20.0, 0.0)  # one reading may be a dip
    assert vehicle.battery_below(20.0, 3.5)
    assert not vehicle.battery_below(10.0, 4.0)
    vehicle.hear(mavlink.MAVLink_extended_sys_state_message(0, 2), 0.0)
    assert vehicle.landed is False
    for chunk, text in enumerate((b"Preflight Fail: ", b"no compass\t")):
        vehicle.hear(mavlink.MAVLink_statustext_message(4, text, 7, chunk), 0.0)
    assert vehicle.text == "Preflight Fail: no compass"


class Heard:
    def __init__(self):
        self.messages = []

    def __call__(self, stamp_ns, odometry):
        self.messages.append((stamp_ns, odometry.copy()))


class Flown:
    """A vehicle with everything that its state needs to be told."""

    def __init__(self, uav=1, overrides=None):
        self.now = 100.0
        self.wall_ns = 10**18
        scenario = load_scenario("experiment_4", overrides)
        self.vehicle = VehicleMonitor(PX4)
        self.world = WorldFrame(scenario, uav, PX4.earth_radius_m)
        self.world.begin()
        self.sync = TimeSync()
        self.controller = ControllerSetpoints()
        self.teller = StatePublisher(self.vehicle, self.world, self.sync, self.controller)
        self.clocks = Clocks(lambda: self.now, lambda: self.wall_ns)
        self.out = Heard()
        self.boot_at = 90.0
        self.vehicle.hear(heartbeat(), self.now)
        self.synchronise()

    def synchronise(self):
        ours = self.sync.ask(self.now)
        self.sync.answered(round((self.now - self.boot_at) * 1e9), ours, self.now)

    def state(self, xyz=(0, 0, 0), late_s=0.01):
        boot_ms = round((self.now - late_s - self.boot_at) * 1e3)
        self.vehicle.hear(attitude(boot_ms), self.now)
        sample = self.vehicle.hear(position(boot_ms, xyz), self.now)
        if sample is not None:
            self.teller.hear(sample, self.clocks, self.out)
        return self.out.messages[-1][1][0:3] if self.out.messages else None

    def later(self, seconds, wall_jump_s=0.0):
        self.now += seconds
        self.wall_ns += round((seconds + wall_jump_s) * 1e9)


def test_the_leader_stands_at_its_start_and_others_where_gps_says():
    leader = Flown(1)
    assert leader.state() is None
    assert "GPS_GLOBAL_ORIGIN" in leader.teller.lack(leader.now)
    # it boots 20 m north of its origin, and that is its start in the scenario
    leader.world.vehicle_at(Anchor(PLACE, np.zeros(3)))
    place = leader.world.stands(np.array([0.0, 20.0, 0.5]))
    assert leader.state((22, 1, -3.5)) == pytest.approx([0.1 + 1, 1.1 + 2, 3], abs=1e-3)
    assert leader.world.stands(np.array([9.0, 9.0, 9.0])) is None  # once
    assert place.latitude_deg - PLACE.latitude_deg == pytest.approx(
        math.degrees(20.0 / PX4.earth_radius_m)
    )

    other = Flown(2)
    away = PLACE._replace(
        latitude_deg=PLACE.latitude_deg + math.degrees(30.0 / PX4.earth_radius_m), altitude_m=490.0
    )
    other.world.vehicle_at(Anchor(away, np.zeros(3)))
    assert other.state() is None
    assert "leader" in other.teller.lack(other.now)
    other.world.leader_at(PLACE)
    assert other.state() == pytest.approx([0.1, 31.1, 2.0], abs=1e-4)
    # home told with its own local position is as good
    home = Flown(2)
    home.world.vehicle_at(Anchor(away, np.array([5.0, 6.0, 0.0])))
    home.world.leader_at(PLACE)
    assert home.state() == pytest.approx([0.1 - 5, 31.1 - 6, 2.0], abs=1e-4)


def test_a_surveyed_origin_and_level_ground_need_no_gps():
    block = {"mavlink.vehicles": {2: {"origin_m": [4, 5, 9]}}, "mavlink.height": "ground"}
    told = Flown(2, block)
    assert told.state((1, 1, 0.4)) == pytest.approx([5, 6, 0.0])
    told.world.freeze()
    assert told.state((1, 1, -2.6)) == pytest.approx([5, 6, 3.0])


def test_the_world_stands_still_from_arming_on():
    told = Flown(1)
    told.world.vehicle_at(Anchor(PLACE, np.zeros(3)))
    told.world.stands(np.zeros(3))
    told.world.freeze()
    told.world.vehicle_at(Anchor(PLACE._replace(altitude_m=500.0), np.zeros(3)))
    assert told.state() == pytest.approx([0.1, 1.1, 0.0])


def told_state():
    told = Flown(1)
    told.world.vehicle_at(Anchor(PLACE, np.zeros(3)))
    told.world.stands(np.zeros(3))
    told.state()
    assert len(told.out.messages) == 1
    return told


def test_old_states_are_not_told():
    told = told_state()
    told.later(0.1)
    told.state(late_s=0.4)
    assert len(told.out.messages) == 1
    assert told.teller.old == 1
    told.later(0.1)
    told.state()
    assert len(told.out.messages) == 2


@pytest.mark.parametrize("jump_s", [100.0, -60.0])
def test_a_jump_of_the_vehicles_clock_stops_the_telling_until_it_is_understood(jump_s):
    told = told_state()
    told.boot_at -= jump_s  # times since boot are now larger, or smaller
    told.later(0.1)
    told.state()
    assert len(told.out.messages) == 1
    assert told.teller.lack(told.now) == "the vehicle's clock jumped"
    assert told.teller.suspicious(told.now)
    for _ in range(3):
        told.later(0.1)
        told.synchronise()
    told.state()
    assert len(told.out.messages) == 2


@pytest.mark.parametrize("jump_s", [3600.0, -3600.0])
def test_a_jump_of_our_wall_clock_hurts_nobody(jump_s):
    told = told_state()
    told.later(0.02, wall_jump_s=jump_s)
    told.state()
    stamps = [stamp for stamp, _ in told.out.messages]
    assert stamps[1] - stamps[0] == pytest.approx((0.02 + jump_s) * 1e9, abs=1e6)
    told.controller.hear(Stamped(stamps[1], np.zeros(6)))
    assert told.controller.age_s(told.now) == pytest.approx(0.01, abs=2e-3)


def test_without_heartbeat_or_fix_nothing_is_told():
    told = told_state()
    told.later(4.0)
    told.state()
    assert len(told.out.messages) == 1
    assert told.teller.lack(told.now) == "no heartbeat for 4.0 s"


def test_only_answers_to_our_own_odometry_count():
    controller = ControllerSetpoints()
    odometry = np.zeros(13)
    odometry[6] = 1.0
    for n in range(3):
        controller.tell(n, PublishedOdometry(10.0 + n, 10.0 + n, odometry))
    assert controller.age_s(20.0) == math.inf
    assert not controller.hear(Stamped(77, np.zeros(6)))
    assert not controller.hear(Stamped(1, np.full(6, math.nan)))
    assert controller.hear(Stamped(1, np.zeros(6)))
    assert not controller.hear(Stamped(0, np.zeros(6)))  # overtaken
    assert controller.age_s(11.25) == 0.25
    assert (controller.foreign, controller.nonsense) == (1, 1)


def test_a_heading_is_read_from_the_yaw_rate_that_would_lead_there():
    odometry = np.zeros(13)
    odometry[5:7] = math.sin(0.5), math.cos(0.5)  # yaw 1.0
    controller = ControllerSetpoints()
    controller.tell(1, PublishedOdometry(0.0, 0.0, odometry))
    controller.hear(Stamped(1, np.array([0, 0, 0, 0, 0, 3.0 * 0.2])))
    assert wanted_yaw(controller.newest, 3.0) == pytest.approx(1.2)
