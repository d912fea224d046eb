"""The bridge as a node: what it tells others of its vehicle, and which orders it obeys."""

import math
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("pymavlink")

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import BatteryState

from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.mavlink.transport import connect
from ptnsbc_io.wire import OdometryTemplate, checked_near
from ptnsbc_nodes.bridge import near_objects
from ptnsbc_nodes.bridge.bridge import WANTED_MESSAGES
from ptnsbc_nodes.bridge.bridge_node import BridgeNode, BridgeOptions
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest, Step, VehicleSnapshot
from ptnsbc_nodes.bridge.vehicle_monitor import Battery
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import decode_order
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.emergency import (
    APART,
    KILL,
    LAND,
    Order,
    VehicleRecord,
    latch,
    latched,
    list_fleet,
    record_path,
    release,
    runtime_folder,
    socket_path,
    write_record,
)
from ptnsbc_nodes.fleet.emergency_stop import EmergencyStop
from ptnsbc_nodes.fleet.fleet import FleetOptions, _listed
from ptnsbc_nodes.fleet.fleet_node import LauncherNode
from ptnsbc_sim.scenario import load_scenario

pytestmark = pytest.mark.ros

UAV = 3


@pytest.fixture
def bridge(ros, monkeypatch):
    """Bridges without a vehicle; their `bridge` does not run, so that a test sets its step."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ros.domain))
    made = []

    def make(fleet="", scenario=None):
        scenario = scenario or load_scenario("experiment_4").bridged()
        edges = CommunicationGraph(scenario, FlightOptions(bridged=True))
        node = ros.node("bridge", namespace=f"{fleet}/uav{UAV}")
        link = MavlinkLink(connect("udpout:127.0.0.1:9"), UAV, WANTED_MESSAGES, None)
        options = BridgeOptions(allow_arming=True)
        bridge_node = BridgeNode(node, scenario, UAV, edges, link, options, lambda _: None)
        bridge_node.bridge.wait_and_serve = lambda: None
        bridge_node.start()
        made.append(bridge_node)
        return bridge_node

    yield make
    for node in made:
        node.close()


@pytest.fixture
def active(bridge):
    return bridge()


def test_the_battery_is_published_once_it_is_known(ros, active):
    heard = []
    viewer = Endpoints(ros.node("viewer"), lockstep=False)
    viewer.listen(topics.battery(UAV), bytes, heard.append)
    ros.spin_until(lambda: not viewer.unheard())
    active.bridge.vehicle.battery.newest = Battery(15.8, None, 75.0)
    ros.spin_until(lambda: heard)
    message = deserialize_message(heard[0], BatteryState)
    assert (message.voltage, message.percentage) == (pytest.approx(15.8), 0.75)
    assert math.isnan(message.current)
    assert message.header.stamp.sec > 0


def test_with_near_links_it_sees_a_vehicle_that_its_uav_does_not_avoid(ros, bridge, monkeypatch):
    """In `figure_eight_4` UAV 3 and UAV 4 share no edge; the separation of the two is watched all the same."""
    for silence in ("_MOVING_S", "_SILENT_S"):  # on a busy machine nobody has fallen silent
        monkeypatch.setattr(near_objects, silence, math.inf)
    work = bridge(scenario=load_scenario("figure_eight_4", {"mavlink.near": "links"}))
    heard, inputs = [], work.bridge.ports.inputs
    viewer = Endpoints(ros.node("viewer"), lockstep=False)
    viewer.listen(topics.near(UAV), checked_near, heard.append, required=False)
    template, odometry = OdometryTemplate("map", "uav4"), np.zeros(13)
    odometry[0:3], odometry[6] = (1.0, 2.0, 3.0), 1.0
    send = viewer.publisher(topics.odom(4), 1)
    work.bridge.state_publisher.odometry = odometry

    def seen():
        send(template.encode(time.time_ns(), odometry))
        work._near.publish_due(work.bridge)
        ros.spin_for(0.02)
        return len(inputs.near_uavs) and heard

    ros.spin_until(seen)
    assert inputs.near_uavs[:, 0:3].tolist() == [[1.0, 2.0, 3.0]]
    assert not any(len(message.values) for message in heard)


@pytest.mark.parametrize("fleet", ["", "/blue"])
def test_a_vehicle_has_one_name_on_every_path(ros, bridge, fleet):
    """Also in a namespace: the launcher's list, socket, record and status name the same bridge."""
    scenario = load_scenario("experiment_4").bridged()
    options = FleetOptions(scenario, backend="mavlink", allow_arming=True, namespace=fleet)
    folder = runtime_folder(ros.domain, fleet)
    with (
        _listed(options, ros.domain, print),
        LauncherNode(ros.domain, "stop", fleet) as node,
    ):
        bridge(fleet)
        assert socket_path(folder, "bridge3").exists()
        assert record_path(folder, "bridge3").exists()
        ros.spin_until(lambda: node.spin(0.02) or node.status.vehicles)
        operation = EmergencyStop(folder, Order(LAND), node)
        try:
            assert operation.bridges == [f"bridge{i}" for i in scenario.uav_ids]
            operation.begin()
            operation.run(0.5)
            obeyed = [one.name for one in operation.outcomes() if one.obeyed]
            assert obeyed == ["bridge3"]
        finally:
            operation.close()


def test_the_order_to_a_bridge_alone_in_a_namespace_needs_no_discovery(ros, bridge):
    folder = runtime_folder(ros.domain, "/blue")
    bridge("/blue")
    list_fleet(folder, ["bridge3"])
    operation = EmergencyStop(folder, Order(KILL))
    try:
        assert operation.local
        operation.begin()
        assert operation.run(30.0)
    finally:
        operation.close()
        list_fleet(folder, [])


def listens_for_orders(ros, active, hear):
    """Another bridge, met by this one."""
    viewer = Endpoints(ros.node("viewer"), lockstep=False)
    viewer.listen(topics.EMERGENCY, decode_order, hear, required=False)
    readers = active.endpoints.readers(topics.EMERGENCY)
    ros.spin_until(lambda: readers() == 2)  # itself and the other


@pytest.mark.parametrize(
    "change", [{"state_fault": "GPS fix lost"}, {"battery_low": "battery at 9 %"}, {"apart": False}]
)
def test_the_others_are_told_at_once_that_the_formation_is_given_up(ros, active, change):
    """Also when this vehicle lands in the same tick, long before the next status."""
    heard, order = [], []
    listens_for_orders(ros, active, heard.append)
    active.node.destroy_timer(active._status_timer)  # nothing is repeated
    bridge = active.bridge
    bridge.procedure.step = Step.FLY
    flies = VehicleSnapshot(
        time.monotonic(), heartbeat_age_s=0.1, controller_age_s=0.1, mode=FlightMode.OWN, armed=True
    )
    given_up = replace(flies, hazard="it swings")
    for snapshot in (flies, given_up, replace(given_up, **change)):
        bridge.snapshot = lambda _now_s, one=snapshot: one
        bridge._tick(snapshot.now_s)
        order.append(bridge.procedure.step)
    expected = Step.APART if change == {"apart": False} else Step.LAND
    assert order == [Step.FLY, Step.APART, expected]
    ros.spin_until(lambda: heard)
    ros.spin_for(0.3)
    assert heard == [Order(APART)]


def test_a_vehicle_that_lands_in_the_tick_of_giving_up_tells_the_others_too(ros, active):
    heard = []
    listens_for_orders(ros, active, heard.append)
    bridge = active.bridge
    bridge.procedure.step = Step.FLY
    bridge.snapshot = lambda now_s: VehicleSnapshot(
        now_s,
        heartbeat_age_s=0.1,
        controller_age_s=0.1,
        mode=FlightMode.OWN,
        armed=True,
        hazard="its position jumped by 2.5 m",
        state_fault="GPS fix lost",
    )
    bridge._tick(time.monotonic())
    assert bridge.procedure.step is Step.LAND
    ros.spin_until(lambda: heard)
    assert heard[0] == Order(APART)


@pytest.mark.parametrize(
    ("order", "armed", "step", "command"),
    [
        (Order(LAND), False, Step.DONE, None),
        (Order(LAND), True, Step.LAND, CommandRequest.LAND),
        (Order(KILL), True, Step.KILL, CommandRequest.KILL),
    ],
)
def test_a_bridge_that_starts_while_an_order_holds_obeys_it(
    ros, bridge, order, armed, step, command
):
    latch(runtime_folder(ros.domain), order)
    work = bridge()
    assert work.bridge.ports.inputs.order == order
    work.bridge.vehicle.armed, work.bridge.vehicle.mode_name = armed, "OFFBOARD"
    work.bridge.vehicle.heartbeat_s = time.monotonic()
    work.bridge._tick(time.monotonic())
    procedure = work.bridge.procedure
    assert (procedure.step, procedure.output.command) == (step, command)
    assert f"the operator's order '{order.text}' still holds" in procedure.fault
    assert work.exit_code == 1


def left_in_flight(ros, **changes):
    """The record of a bridge that has died."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    link = load_scenario("experiment_4").bridged().vehicle_link(UAV)
    known = {"heard": True, "armed": True, "mode": "OFFBOARD", "frame": "1.0 2.0 3.0"}
    left = VehicleRecord("bridge3", process.pid, link.sysid, "px4", link.connect, "127.0.0.1:9")
    write_record(runtime_folder(ros.domain), replace(left, **{**known, **changes}))


def test_a_bridge_that_starts_knows_what_the_one_that_died_has_left(ros, bridge):
    """Until it hears the vehicle it answers with that: "never heard" had counted as obeyed."""
    folder = runtime_folder(ros.domain)
    left_in_flight(ros)
    list_fleet(folder, ["bridge3"])
    work = bridge()
    assert work.bridge.procedure.takes_over
    assert work.bridge.state_publisher.world.offset.tolist() == [1.0, 2.0, 3.0]
    assert work.orders.keep().frame == "1.0 2.0 3.0"
    operation = EmergencyStop(folder, Order(LAND))
    try:
        operation.begin()
        assert not operation.run(1.3)
        (outcome,) = operation.outcomes()
        assert outcome.text.startswith("answers, but the vehicle does not obey: silent, last armed")
        assert "told past it by MAVLink" in outcome.text  # after a second
    finally:
        operation.close()
        list_fleet(folder, [])
    work.bridge._tick(time.monotonic())
    assert work.bridge.procedure.step is Step.HEARTBEAT
    work.bridge.vehicle.heartbeat_s, work.bridge.vehicle.armed = time.monotonic(), True
    work.bridge.vehicle.mode_name = "OFFBOARD"
    work.bridge._tick(time.monotonic())
    assert work.bridge.procedure.step is Step.LAND


@pytest.mark.parametrize("changes", [{"armed": False}, {"in_pilots_hands": True}, {"connect": "x"}])
def test_what_was_not_left_in_flight_is_not_remembered(ros, bridge, changes):
    left_in_flight(ros, **changes)
    work = bridge()
    assert not (work.orders.keep().armed or work.bridge.procedure.takes_over)


def test_a_bridge_that_starts_after_the_order_was_released_obeys_none(ros, bridge):
    folder = runtime_folder(ros.domain)
    latch(folder, Order(KILL))
    release(folder)
    work = bridge()
    assert work.bridge.ports.inputs.order == Order()
    assert work.exit_code == 0


def test_an_order_that_a_bridge_heard_holds_for_the_next_one(ros, active):
    """`apart` is of one flight and holds for no other."""
    folder = runtime_folder(ros.domain)
    active.orders.on_order(Order(APART))
    assert latched(folder) == Order()
    active.orders.on_order(Order(LAND))
    assert latched(folder) == Order(LAND)
