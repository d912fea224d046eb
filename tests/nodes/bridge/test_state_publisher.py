"""The published state: in the world frame, on our clock, and only while it is fresh and plausible."""

import math

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_wires import attitude, heartbeat, position

from ptnsbc_io.mavlink.autopilots import PX4
from ptnsbc_io.mavlink.frames import EARTH_RADIUS_M, GeoPoint
from ptnsbc_io.mavlink.timesync import TimeSync
from ptnsbc_io.wire import VelocityTemplate, decode_velocity
from ptnsbc_nodes.bridge.ports import BridgePorts
from ptnsbc_nodes.bridge.state_publisher import (
    ControllerSetpoints,
    PublishedOdometry,
    StatePublisher,
)
from ptnsbc_nodes.bridge.vehicle_monitor import Anchor, VehicleMonitor
from ptnsbc_sim.scenario import load_scenario

PLACE = GeoPoint(47.397742, 8.545594, 488.0)


class Flown:
    """A vehicle with everything that its state needs to be published."""

    def __init__(self, uav=1, overrides=None):
        self.now = 100.0
        self.wall_ns = 10**18
        scenario = load_scenario("experiment_4", overrides)
        self.vehicle = VehicleMonitor(PX4)
        self.sync = TimeSync()
        self.published = []  # stamp and odometry
        ports = BridgePorts(lambda: self.now, lambda: self.wall_ns)
        ports.odom = lambda stamp_ns, odometry: self.published.append((stamp_ns, odometry.copy()))
        self.publisher = StatePublisher(scenario, uav, self.vehicle, self.sync, ports)
        self.world, self.controller = self.publisher.world, self.publisher.controller
        self.boot_at = 90.0
        self.vehicle.on_message(heartbeat(), self.now)
        self.synchronise()

    def synchronise(self):
        ours = self.sync.request(self.now)
        self.sync.on_answer(round((self.now - self.boot_at) * 1e9), ours, self.now)

    def state(self, xyz=(0, 0, 0), late_s=0.01):
        boot_ms = round((self.now - late_s - self.boot_at) * 1e3)
        self.vehicle.on_message(attitude(boot_ms), self.now)
        sample = self.vehicle.on_message(position(boot_ms, xyz), self.now)
        if sample is not None:
            self.publisher.on_state(sample, in_formation=True)
        return self.published[-1][1][0:3] if self.published else None

    def later(self, seconds, wall_jump_s=0.0):
        self.now += seconds
        self.wall_ns += round((seconds + wall_jump_s) * 1e9)


def test_the_leader_stands_at_its_start_and_others_where_gps_says():
    leader = Flown(1)
    assert leader.state() is None
    assert "GPS_GLOBAL_ORIGIN" in leader.publisher.fault(leader.now)
    # it boots 20 m north of its origin, and that is its start in the scenario
    leader.world.vehicle_at(Anchor(PLACE, np.zeros(3)))
    place = leader.world.define_by_leader(np.array([0.0, 20.0, 0.5]))
    assert leader.state((22, 1, -3.5)) == pytest.approx([0.1 + 1, 1.1 + 2, 3], abs=1e-3)
    assert leader.world.define_by_leader(np.array([9.0, 9.0, 9.0])) is None  # once
    assert place.latitude_deg - PLACE.latitude_deg == pytest.approx(
        math.degrees(20.0 / EARTH_RADIUS_M["px4"])
    )

    other = Flown(2)
    away = PLACE._replace(
        latitude_deg=PLACE.latitude_deg + math.degrees(30.0 / EARTH_RADIUS_M["px4"]),
        altitude_m=490.0,
    )
    other.world.vehicle_at(Anchor(away, np.zeros(3)))
    assert other.state() is None
    assert "leader" in other.publisher.fault(other.now)
    other.world.leader_at(PLACE)
    assert other.state() == pytest.approx([0.1, 31.1, 2.0], abs=1e-4)
    # a home position with its own local position is as good
    home = Flown(2)
    home.world.vehicle_at(Anchor(away, np.array([5.0, 6.0, 0.0])))
    home.world.leader_at(PLACE)
    assert home.state() == pytest.approx([0.1 - 5, 31.1 - 6, 2.0], abs=1e-4)


def test_a_surveyed_origin_and_level_ground_need_no_gps():
    block = {"mavlink.vehicles": {2: {"origin_m": [4, 5, 9]}}, "mavlink.height": "ground"}
    flown = Flown(2, block)
    assert flown.state((1, 1, 0.4)) == pytest.approx([5, 6, 0.0])
    flown.world.frozen = True
    assert flown.state((1, 1, -2.6)) == pytest.approx([5, 6, 3.0])


def test_the_world_stands_still_from_arming_on():
    flown = Flown(1)
    flown.world.vehicle_at(Anchor(PLACE, np.zeros(3)))
    flown.world.define_by_leader(np.zeros(3))
    flown.world.frozen = True
    flown.world.vehicle_at(Anchor(PLACE._replace(altitude_m=500.0), np.zeros(3)))
    assert flown.state() == pytest.approx([0.1, 1.1, 0.0])


def flown_state():
    flown = Flown(1)
    flown.world.vehicle_at(Anchor(PLACE, np.zeros(3)))
    flown.world.define_by_leader(np.zeros(3))
    flown.state()
    assert len(flown.published) == 1
    return flown


def test_old_states_are_not_published():
    flown = flown_state()
    flown.later(0.1)
    flown.state(late_s=0.4)
    assert len(flown.published) == 1
    assert flown.publisher.dropped["old"] == 1
    flown.later(0.1)
    flown.state()
    assert len(flown.published) == 2


@pytest.mark.parametrize("jump_s", [100.0, -60.0])
def test_a_jump_of_the_vehicles_clock_stops_the_publishing_until_it_is_understood(jump_s):
    flown = flown_state()
    flown.boot_at -= jump_s  # times since boot are now larger, or smaller
    flown.later(0.1)
    flown.state()
    assert len(flown.published) == 1
    assert flown.publisher.fault(flown.now) == "the vehicle's clock jumped"
    assert flown.publisher.clock_jumped(flown.now)
    for _ in range(3):
        flown.later(0.1)
        flown.synchronise()
    flown.state()
    assert len(flown.published) == 2


@pytest.mark.parametrize("jump_s", [3600.0, -3600.0])
def test_a_jump_of_our_wall_clock_hurts_nobody(jump_s):
    flown = flown_state()
    flown.later(0.02, wall_jump_s=jump_s)
    flown.state()
    stamps = [stamp for stamp, _ in flown.published]
    assert stamps[1] - stamps[0] == pytest.approx((0.02 + jump_s) * 1e9, abs=1e6)
    flown.controller.on_message(VelocityTemplate("map").encode(stamps[1], np.zeros(6)))
    assert flown.controller.age_s(flown.now) == pytest.approx(0.01, abs=2e-3)


def test_without_heartbeat_or_fix_nothing_is_published():
    flown = flown_state()
    flown.later(4.0)
    flown.state()
    assert len(flown.published) == 1
    assert flown.publisher.fault(flown.now) == "no heartbeat for 4.0 s"
    flown.vehicle.heartbeat_s = None  # none has come yet
    assert flown.publisher.fault(flown.now) == "no heartbeat"


def receive(controller, stamp_ns, values):
    return controller.on_message(VelocityTemplate("map").encode(stamp_ns, values))


def test_only_answers_to_our_own_odometry_count():
    controller = ControllerSetpoints(decode_velocity)
    odometry = np.zeros(13)
    odometry[6] = 1.0
    for n in range(3):
        controller.remember(n, PublishedOdometry(10.0 + n, 10.0 + n, odometry))
    assert controller.age_s(20.0) == math.inf
    assert not receive(controller, 77, np.zeros(6))
    assert not receive(controller, 1, np.full(6, math.nan))
    assert receive(controller, 1, np.zeros(6))
    assert not receive(controller, 0, np.zeros(6))  # overtaken
    assert controller.age_s(11.25) == 0.25
    assert (controller.foreign, controller.invalid) == (1, 1)


def test_a_heading_is_read_from_the_yaw_rate_that_would_lead_there():
    odometry = np.zeros(13)
    odometry[5:7] = math.sin(0.5), math.cos(0.5)  # yaw 1.0
    controller = ControllerSetpoints(decode_velocity)
    controller.remember(1, PublishedOdometry(0.0, 0.0, odometry))
    receive(controller, 1, np.array([0, 0, 0, 0, 0, 3.0 * 0.2]))
    assert controller.newest.desired_yaw(3.0) == pytest.approx(1.2)
