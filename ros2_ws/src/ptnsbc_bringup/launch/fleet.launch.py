"""A whole flight on this computer: `ptnsbc fleet` under launch, with viewers beside it.

    ros2 launch ptnsbc_bringup fleet.launch.py scenario:=paper_5 rviz:=true record:=flight
    ros2 launch ptnsbc_bringup fleet.launch.py --show-args

The processes of the flight belong to `ptnsbc fleet`: it starts and watches them, ends them in order and prints the
verdict. This file imports nothing of the stack, whose packages may live in an interpreter of their own.
"""

from __future__ import annotations

import os
import shlex
from pathlib import Path

from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
)
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.events import matches_action
from launch.events.process import ProcessExited, ShutdownProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# [s] from SIGINT to the harder signals: a bridge lands its vehicle, and the recorder completes its bag.
PATIENCE_S = "300"
FLAGS = ("true", "false")
SWITCHES = ("lockstep", "allow_arming", "overwrite", "check", "wait")
VALUES = ("backend", "namespace", "duration", "mission")
VIEWERS = {"rviz": "rviz2", "foxglove": "foxglove_bridge"}
VIEWED = ("/formation/markers", "/clock")


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the flight is made when they are known."""

    def argument(name: str, default: str, description: str, **more) -> DeclareLaunchArgument:
        return DeclareLaunchArgument(name, default_value=default, description=description, **more)

    def flag(name: str, description: str) -> DeclareLaunchArgument:
        return argument(name, "false", description, choices=FLAGS)

    return LaunchDescription(
        [
            argument("scenario", "paper_5", "scenario file or name"),
            argument(
                "backend",
                "sim",
                "the simulator, or a MAVLink bridge per flight controller",
                choices=["sim", "mavlink"],
            ),
            flag("allow_arming", "arm real vehicles and take off"),
            flag("lockstep", "as fast as it goes, the same bytes every time; or by the wall clock"),
            argument("namespace", "", "of all nodes and topics: two fleets in one domain"),
            argument("duration", "", "length of the flight [s], instead of the scenario's"),
            argument("mission", "", "file with the legs to fly, instead of the scenario's"),
            argument("set", "", "other keys of the scenario: 'KEY=VALUE KEY=VALUE'"),
            argument("record", "", "record into this folder"),
            flag("overwrite", "replace an existing recording"),
            flag("check", "dry runs before anything starts; a scenario that they miss is refused"),
            flag("wait", "an operator starts the flight, by /formation/start"),
            flag("rviz", "show the formation"),
            flag(
                "foxglove",
                "foxglove_bridge on port 8765; the layout is in share/ptnsbc_bringup",
            ),
            OpaqueFunction(function=flight),
        ]
    )


def flight(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """The flight, the viewers that were asked for, and what its end leads to."""

    def told(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    namespace = told("namespace").strip("/")
    viewers = [_viewer(name, namespace) for name in VIEWERS if told(name) == "true"]
    program = Path(get_package_prefix("ptnsbc_tools")) / "lib" / "ptnsbc_tools" / "ptnsbc"
    words = ["fleet", told("scenario")]
    words += [f"--{name.replace('_', '-')}" for name in SWITCHES if told(name) == "true"]
    for name in VALUES:
        if told(name):
            words += [f"--{name.replace('_', '-')}", told(name)]
    for setting in shlex.split(told("set")):
        words += ["--set", setting]
    if told("record"):
        words += ["--bag", str(Path(told("record")).expanduser().absolute())]

    def ended(event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity]:
        if event.returncode:
            # launch answers with 1 after any exception; shutting it down would end what else it runs.
            context.asyncio_loop.call_exception_handler(
                {"message": f"the flight of {told('scenario')} ended with {event.returncode}"}
            )
        return [
            EmitEvent(event=ShutdownProcess(process_matcher=matches_action(viewer)))
            for viewer in viewers
        ]

    fleet = ExecuteProcess(
        cmd=[str(program), *words],
        name="fleet",
        output="screen",
        sigterm_timeout=PATIENCE_S,
        # The flight ends in order when launch is killed.
        additional_env={"PTNSBC_PARENT": str(os.getpid())},
    )
    over = RegisterEventHandler(OnProcessExit(target_action=fleet, on_exit=ended))
    return [over, fleet, *viewers]


def _viewer(name: str, namespace: str) -> Node:
    package = VIEWERS[name]
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        raise RuntimeError(
            f"{name}:=true: the package {package} is not installed: "
            f"sudo apt install ros-jazzy-{package.replace('_', '-')}"
        ) from None
    layout = Path(get_package_share_directory("ptnsbc_bringup")) / "rviz" / "formation.rviz"
    words: list[str] = []
    if name == "rviz":
        words = ["-d", str(layout)]
        if namespace:
            # The layout names the topics of a fleet without a namespace.
            words += ["--ros-args"]
            for topic in VIEWED:
                words += ["-r", f"{topic}:=/{namespace}{topic}"]
    return Node(package=package, executable=package, arguments=words)
