"""Start a formation: one process per UAV, the simulator and the recorder.

    ros2 launch ptnsbc_bringup fleet.launch.py scenario:=/path/to/paper_5.yaml lockstep:=true

`launch` comes with ROS from apt only; with the ROS wheels, `ptnsbc_nodes.fleet` does the same.
"""

from pathlib import Path

import yaml
from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SHARE = Path(get_package_share_directory("ptnsbc_bringup"))


def nodes(context: LaunchContext) -> list[Node | RegisterEventHandler]:
    """Build the actions once the arguments are known: the scenario says how many UAVs there are."""
    path = Path(LaunchConfiguration("scenario").perform(context)).expanduser().resolve()
    lockstep = LaunchConfiguration("lockstep").perform(context).lower() in ("true", "1")
    uav_ids = [uav["id"] for uav in yaml.safe_load(path.read_text(encoding="utf-8"))["uavs"]]

    parameters = [
        str(SHARE / "config" / "fleet.yaml"),
        {"scenario": str(path), "lockstep": lockstep},
    ]
    common = {"package": "ptnsbc_nodes", "output": "screen"}
    sim = Node(executable="sim_node", name="sim", parameters=parameters, **common)
    recorder = Node(
        executable="recorder",
        name="recorder",
        parameters=[*parameters, {"output": LaunchConfiguration("output")}],
        **common,
    )
    uavs = [
        Node(
            executable="uav_node",
            name="uav",
            namespace=f"uav{uav_id}",
            parameters=[*parameters, {"uav_id": uav_id}],
            **common,
        )
        for uav_id in uav_ids
    ]
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", str(SHARE / "rviz" / "formation.rviz")],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    end = RegisterEventHandler(
        OnProcessExit(target_action=sim, on_exit=[EmitEvent(event=Shutdown(reason="sim is done"))])
    )
    return [recorder, *uavs, sim, rviz, end]


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; `ros2 launch ... --show-args` lists them."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("scenario", description="scenario file (YAML)"),
            DeclareLaunchArgument("lockstep", default_value="false", description="or real time"),
            DeclareLaunchArgument("output", default_value="", description="bag; empty: a new one"),
            DeclareLaunchArgument("rviz", default_value="false", description="show the formation"),
            OpaqueFunction(function=nodes),
        ]
    )
