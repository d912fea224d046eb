"""A whole flight on this computer, with the processes of `ptnsbc fleet`: started, activated, flown, ended.

    ros2 launch ptnsbc_bringup fleet.launch.py scenario:=paper_5 rviz:=true record:=flight
    ros2 launch ptnsbc_bringup fleet.launch.py --show-args

`launch` comes with ROS from apt; with the ROS wheels, `ptnsbc fleet` does the same.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from ptnsbc_nodes.fleet.child_process import EXECUTABLES, ProcessCommand
from ptnsbc_nodes.fleet.fleet import check_options
from ptnsbc_nodes.fleet.process_list import FleetOptions, commands, coordinator_command
from ptnsbc_nodes.runtime.environment import ONE_THREAD
from ptnsbc_nodes.runtime.warmup import load_agent, load_world
from ptnsbc_sim.scenario import load_scenario

# [s] between SIGINT and the harder signals: a recorder completes its bag, a bridge lands its vehicle.
PATIENCE_S = {"ptnsbc_nodes.recording.main": "60", "ptnsbc_nodes.bridge.main": "240"}
FLAGS = ("true", "false")


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the processes depend on the scenario and are made when it is known."""
    argument = DeclareLaunchArgument
    return LaunchDescription(
        [
            argument("scenario", default_value="paper_5", description="scenario file or name"),
            argument(
                "backend",
                default_value="sim",
                choices=["sim", "mavlink"],
                description="the simulator, or a MAVLink bridge per flight controller",
            ),
            argument(
                "allow_arming",
                default_value="false",
                choices=FLAGS,
                description="arm real vehicles and take off",
            ),
            argument(
                "lockstep",
                default_value="false",
                choices=FLAGS,
                description="as fast as it goes, the same bytes every time; or by the wall clock",
            ),
            argument("record", default_value="", description="record into this folder"),
            argument(
                "rviz", default_value="false", choices=FLAGS, description="show the formation"
            ),
            argument(
                "foxglove",
                default_value="false",
                choices=FLAGS,
                description="foxglove_bridge on port 8765; the layout is in share/ptnsbc_bringup",
            ),
            OpaqueFunction(function=flight),
        ]
    )


def flight(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """All processes of a flight, and what ends it."""
    options = _options(context)
    # Compiled once, before a dozen processes would do it side by side.
    load_agent(options.scenario, options.scenario.leader_id)
    if options.backend == "sim":
        load_world(options.scenario)
    # Without its `extends`: what the bag carries has to be read anywhere.
    file = Path(tempfile.mkdtemp(prefix="ptnsbc-")) / "scenario.yaml"
    file.write_text(options.scenario.text, encoding="utf-8")
    processes = commands(options, file)
    nodes = [_node(command) for command in processes]
    bridged = ["--bridged"] if options.backend == "mavlink" else []
    coordinator = _node(coordinator_command(file, "--manage", *bridged))
    return [*nodes, coordinator, *_ends(processes, nodes, file), *_viewers()]


def _options(context: LaunchContext) -> FleetOptions:
    def told(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    scenario, record = load_scenario(told("scenario")), told("record")
    options = FleetOptions(
        scenario.bridged() if told("backend") == "mavlink" else scenario,
        backend=told("backend"),
        allow_arming=told("allow_arming") == "true",
        lockstep=told("lockstep") == "true",
        bag=Path(record).absolute() if record else None,
    )
    check_options(options)
    return options


def _node(command: ProcessCommand) -> Node:
    patience = PATIENCE_S.get(command.module)
    return Node(
        package="ptnsbc_nodes",
        executable=EXECUTABLES[command.module],
        # Relative, so that a namespace around all of it moves the whole fleet.
        namespace="" if command.uav is None else f"uav{command.uav}",
        arguments=list(command.arguments),
        additional_env=dict.fromkeys(ONE_THREAD, "1"),
        output="screen",
        **({} if patience is None else {"sigterm_timeout": patience}),
    )


def _ends(
    processes: list[ProcessCommand], nodes: list[Node], file: Path
) -> list[RegisterEventHandler]:
    """The flight ends with the sim, the last bridge or the last UAV. Of any other end the rest is told."""
    flies = {command.name for command in processes if command.ends}
    uavs = {command.name for command in processes if command.uav is not None and not command.ends}

    def gone(command: ProcessCommand, event: ProcessExited) -> list[LaunchDescriptionEntity]:
        flies.discard(command.name)
        uavs.discard(command.name)
        if not flies:
            return [EmitEvent(event=Shutdown(reason="the flight is over"))]
        if not uavs:
            return [EmitEvent(event=Shutdown(reason="no UAV is left"))]
        landed = command.ends and event.returncode == 0
        return [] if landed else [_node(coordinator_command(file, "--lose", command.lost))]

    def handler(command: ProcessCommand, node: Node) -> RegisterEventHandler:
        on_exit = OnProcessExit(
            target_action=node, on_exit=lambda event, _context: gone(command, event)
        )
        return RegisterEventHandler(on_exit)

    return [handler(command, node) for command, node in zip(processes, nodes, strict=True)]


def _viewers() -> list[Node]:
    layout = Path(get_package_share_directory("ptnsbc_bringup")) / "rviz" / "formation.rviz"
    return [
        Node(
            package="rviz2",
            executable="rviz2",
            arguments=["-d", str(layout)],
            condition=IfCondition(LaunchConfiguration("rviz")),
        ),
        Node(
            package="foxglove_bridge",
            executable="foxglove_bridge",
            condition=IfCondition(LaunchConfiguration("foxglove")),
        ),
    ]
