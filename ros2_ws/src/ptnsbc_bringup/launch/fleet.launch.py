"""Start a formation: one process per UAV, the simulator and, with a bag, the recorder.

    ros2 launch ptnsbc_bringup fleet.launch.py scenario:=paper_5 bag:=flight
    ros2 service call /formation/start std_srvs/srv/Trigger

The second command begins the flight; the leader refuses it until all are ready. `launch` comes with
ROS from apt only; with the ROS wheels, `ros2 run ptnsbc_nodes fleet` does all of it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from ptnsbc_sim.scenario import load_scenario

RECORDER_PATIENCE_S = "60"  # what is still queued belongs into the bag


def command_lines(
    scenario: Path, uav_ids: Sequence[int], *, lockstep: bool, bag: str
) -> list[tuple[str, list[str]]]:
    """Executables of ptnsbc_nodes and their arguments, in the order of their start."""
    clock = ["--lockstep"] if lockstep else []
    common = ["--scenario", str(scenario), *clock, *(["--recorded"] if bag else [])]
    recorder = ["--bag", bag, "--uavs", *map(str, uav_ids), *clock]
    recorder += ["--attach", f"scenario.yaml={scenario}"]
    return [
        *([("recorder", recorder)] if bag else []),
        ("sim", common),
        *(("uav", [*common, "--uav", str(uav_id)]) for uav_id in uav_ids),
    ]


def _node(executable: str, arguments: list[str]) -> Node:
    patience = {"sigterm_timeout": RECORDER_PATIENCE_S} if executable == "recorder" else {}
    # No name and no namespace: each process names its own node.
    return Node(
        package="ptnsbc_nodes",
        executable=executable,
        arguments=arguments,
        output="screen",
        **patience,
    )


def nodes(context: LaunchContext) -> list[Node | RegisterEventHandler]:
    """Build the actions once the arguments are known: the scenario says how many UAVs there are."""
    scenario = load_scenario(LaunchConfiguration("scenario").perform(context))
    lockstep = LaunchConfiguration("lockstep").perform(context).lower() in ("true", "1")
    bag = LaunchConfiguration("bag").perform(context)
    # Without its `extends`: what the bag carries has to be read anywhere.
    path = Path(tempfile.mkdtemp(prefix="ptnsbc-")) / "scenario.yaml"
    path.write_text(scenario.text, encoding="utf-8")
    lines = command_lines(path, scenario.uav_ids, lockstep=lockstep, bag=bag)
    crew = [_node(executable, arguments) for executable, arguments in lines]
    sim = crew[[executable for executable, _ in lines].index("sim")]
    layout = Path(get_package_share_directory("ptnsbc_bringup")) / "rviz" / "formation.rviz"
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", str(layout)],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    end = RegisterEventHandler(
        OnProcessExit(target_action=sim, on_exit=[EmitEvent(event=Shutdown(reason="sim is done"))])
    )
    return [*crew, rviz, end]


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; `ros2 launch ... --show-args` lists them."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("scenario", description="scenario file or name"),
            DeclareLaunchArgument("lockstep", default_value="false", description="or real time"),
            DeclareLaunchArgument("bag", default_value="", description="record into this folder"),
            DeclareLaunchArgument("rviz", default_value="false", description="show the formation"),
            OpaqueFunction(function=nodes),
        ]
    )
