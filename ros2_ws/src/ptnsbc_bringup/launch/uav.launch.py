"""One UAV on its own computer: its controller, and the bridge to its flight controller if it has one.

    ros2 launch ptnsbc_bringup uav.launch.py uav:=2 scenario:=paper_5
    ros2 launch ptnsbc_bringup uav.launch.py uav:=2 scenario:=experiment_4 bridge:=true allow_arming:=true

The vehicle arms when all UAVs of the fleet are ready, and the formation starts when the leader is told to:

    ros2 service call /formation/start std_srvs/srv/Trigger

Every computer of the fleet has the same scenario file, and is told the same values in set:=.
"""

from __future__ import annotations

import shlex

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

# A copy: `ros2` runs in the system's interpreter, which may not have what the stack needs.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
LANDING_S = "240"  # a bridge that is told to end lands its vehicle first
FLAGS = ("true", "false")


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments."""
    argument = DeclareLaunchArgument
    return LaunchDescription(
        [
            argument("uav", description="id of this UAV"),
            argument("scenario", description="scenario file or name"),
            argument(
                "set",
                default_value="",
                description="other keys of the scenario: 'KEY=VALUE KEY=VALUE'",
            ),
            argument(
                "bridge",
                default_value="false",
                choices=FLAGS,
                description="fly a flight controller over MAVLink",
            ),
            argument(
                "allow_arming",
                default_value="false",
                choices=FLAGS,
                description="arm the vehicle and take off",
            ),
            argument(
                "recorded",
                default_value="false",
                choices=FLAGS,
                description="be ready only when a recorder listens",
            ),
            argument(
                "use_sim_time", default_value="false", choices=FLAGS, description="follow /clock"
            ),
            OpaqueFunction(function=uav),
        ]
    )


def uav(context: LaunchContext) -> list[Node]:
    """The nodes of one UAV."""

    def told(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    common = ["--recorded"] if told("recorded") == "true" else []
    common += ["--uav", told("uav"), "--scenario", told("scenario")]
    for setting in shlex.split(told("set")):
        common += ["--set", setting]
    bridged = told("bridge") == "true"
    controller = _node("uav", [*common, *(["--bridged"] if bridged else [])], told)
    if not bridged:
        return [controller]
    arming = ["--allow-arming"] if told("allow_arming") == "true" else []
    return [
        controller,
        _node("bridge", [*common, "--with-fleet", *arming], told, sigterm_timeout=LANDING_S),
    ]


def _node(executable, arguments, told, **patience) -> Node:
    return Node(
        package="ptnsbc_nodes",
        executable=executable,
        # Relative, so that a namespace around it moves the whole fleet.
        namespace=f"uav{told('uav')}",
        arguments=arguments,
        parameters=[{"use_sim_time": told("use_sim_time") == "true"}],
        additional_env=dict.fromkeys(ONE_THREAD, "1"),
        output="screen",
        **patience,
    )
