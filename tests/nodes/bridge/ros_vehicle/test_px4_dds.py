"""The example of a driver for PX4 behind uXRCE-DDS, with a stand-in of its topics."""

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("pymavlink")
pytest.importorskip("px4_msgs.msg", reason="make test builds it where g++ is")

from px4_msgs import msg as px4_msgs

from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest
from ptnsbc_nodes.bridge.ros_vehicle.topics import open_ros_link
from ptnsbc_nodes.comm.qos import keep_last
from ptnsbc_sim.scenario import load_scenario

pytestmark = pytest.mark.ros

EXAMPLE = Path(__file__).parents[4] / "examples" / "vehicles" / "px4_dds.py"
OUT = keep_last(5, reliable=False, latched=True)  # as the agent offers what PX4 sends
OFFBOARD, LANDING = 14, 18


class StandIn:
    """The topics of one PX4, which does at once what it is told."""

    def __init__(self, node, name):
        fmu = f"/{name}/fmu"
        self.commands, self.kept, self.setpoints = [], [], []
        kinds = {"Odometry": "vehicle_odometry", "Status": "vehicle_status_v1"}
        self.out = {
            kind: node.create_publisher(
                getattr(px4_msgs, f"Vehicle{kind}"), f"{fmu}/out/{topic}", OUT
            )
            for kind, topic in {**kinds, "LandDetected": "vehicle_land_detected"}.items()
        }
        hear = node.create_subscription
        best = keep_last(10, reliable=False)  # as the agent asks for what PX4 hears
        hear(px4_msgs.VehicleCommand, f"{fmu}/in/vehicle_command", self.on_command, best)
        hear(
            px4_msgs.OffboardControlMode, f"{fmu}/in/offboard_control_mode", self.kept.append, best
        )
        hear(
            px4_msgs.TrajectorySetpoint,
            f"{fmu}/in/trajectory_setpoint",
            self.setpoints.append,
            best,
        )
        self.status = px4_msgs.VehicleStatus(arming_state=1, nav_state=4, system_id=3)

    def on_command(self, message):
        self.commands.append(message)
        if message.command == 176:
            self.status.nav_state = OFFBOARD
        elif message.command == 400:
            self.status.arming_state = 2 if message.param1 else 1
        elif message.command == 21:
            self.status.nav_state = LANDING
        self.out["Status"].publish(self.status)


@pytest.fixture
def px4(ros, tmp_path):
    file = tmp_path / "dds.yaml"
    file.write_text(
        f"extends: lab_4\nname: dds\nros: {{name: 'px4_{{n}}'}}\nplugins: {{vehicle: {EXAMPLE}:Px4}}\n"
    )
    link = open_ros_link(ros.node("bridge"), load_scenario(file).bridged(ros=True), 1)
    link.stand_in = StandIn(ros.node("px4"), "px4_1")
    publishers = link.stand_in.out.values()
    ros.spin_until(lambda: all(one.get_subscription_count() for one in publishers))
    return link


def test_it_tells_where_it_is_in_our_axes(ros, px4):
    message = px4_msgs.VehicleOdometry(pose_frame=1, velocity_frame=1, timestamp_sample=5_000_000)
    message.position, message.velocity = [2.0, 1.0, -3.0], [0.5, 0.0, 0.0]  # north, east, down
    message.q = [1.0, 0.0, 0.0, 0.0]  # its nose to the north
    px4.stand_in.out["Odometry"].publish(message)
    ros.spin_until(lambda: px4.position.any())
    assert px4.position.tolist() == [1.0, 2.0, 3.0]
    assert px4.velocity.tolist() == pytest.approx([0.5, 0.0, 0.0])
    (odometry,) = (m for m in px4.poll(0.0) if m.get_type() == "ODOMETRY")
    assert odometry.q == pytest.approx([1.0, 0.0, 0.0, 0.0])
    message.pose_frame = 2  # a frame of unknown heading
    message.position = [9.0, 9.0, 9.0]
    px4.stand_in.out["Odometry"].publish(message)
    ros.spin_for(0.1)
    assert px4.position.tolist() == [1.0, 2.0, 3.0]


def test_its_setpoints_are_in_ned_and_leave_the_rest_to_it(ros, px4):
    stand_in = px4.stand_in
    both = lambda: stand_in.setpoints and stand_in.kept  # noqa: E731
    up = np.array([1.0, 2.0, 3.0])
    ros.spin_until(lambda: both() or px4.fly(up, None, None, 0.0))
    kept, sent = stand_in.kept[-1], stand_in.setpoints[-1]
    assert (kept.position, kept.velocity) == (True, False)
    assert sent.position.tolist() == [2.0, 1.0, -3.0]
    assert np.isnan(sent.velocity).all()
    assert sent.yaw == pytest.approx(0.5 * math.pi)
    assert sent.timestamp > 1e15  # [us], the clock of the agent
    stand_in.kept.clear()
    ros.spin_until(lambda: stand_in.kept or px4.fly(up, up, up, 0.0))
    assert (stand_in.kept[-1].position, stand_in.kept[-1].velocity) == (False, True)


def test_its_commands_are_obeyed_and_its_state_is_its_own_word(ros, px4):
    stand_in = px4.stand_in
    stand_in.out["LandDetected"].publish(px4_msgs.VehicleLandDetected(landed=False))
    ros.spin_until(lambda: px4.landed is False)
    for request, shows in {
        CommandRequest.OWN_MODE: lambda: px4.mode is FlightMode.OWN,
        CommandRequest.ARM: lambda: px4.armed,
        CommandRequest.LAND: lambda: px4.mode is FlightMode.LAND,
    }.items():
        ros.spin_until(lambda request=request, shows=shows: shows() or px4.request(request))
    assert not px4.down
    assert stand_in.commands[-1].target_system == 3  # as its status has it
    stand_in.out["LandDetected"].publish(px4_msgs.VehicleLandDetected(landed=True))
    ros.spin_until(lambda: px4.down)
    ros.spin_until(lambda: not px4.armed or px4.request(CommandRequest.KILL))
    assert stand_in.commands[-1].param2 == 21196.0
    stand_in.status.nav_state = 2  # a pilot
    stand_in.out["Status"].publish(stand_in.status)
    ros.spin_until(lambda: px4.mode is FlightMode.OTHER)
