"""The ROS parameters of a node of a flight: the scenario that it flies, for viewers, and those of ROS itself.

No parameter sets a value of the flight: all its processes and its bag must agree, so they read one scenario file.
"""

from __future__ import annotations

from collections.abc import Iterable

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario

SCENARIO = "scenario"
"""Name of the parameter that holds the whole text of the scenario."""
SIM_TIME = "use_sim_time"
_OF_ROS = (SIM_TIME, "start_type_description_service")
_OF_QOS = "qos_overrides."


class NodeParameterError(PtnsbcError):
    """A parameter that a process cannot be started with."""


def fix_parameters(node: Node, scenario: Scenario) -> None:
    """Tell viewers the scenario, and let nobody change the node's time in flight.

    Raises:
        NodeParameterError: the node, which has declared every parameter that it was given, has one that is not of ROS.
    """
    for name in node.get_parameters_by_prefix(""):
        if name not in _OF_ROS and not name.startswith(_OF_QOS):
            raise NodeParameterError(
                f"parameter {name}: a flight takes no values from ROS parameters: expected it in the scenario file, "
                f"--scenario FILE, or --set {name}=VALUE"
            )
    about = ParameterDescriptor(description="the scenario that is flown", read_only=True)
    node.declare_parameter(SCENARIO, scenario.text, about)
    node.add_on_set_parameters_callback(_fixed)


def _fixed(parameters: Iterable[Parameter]) -> SetParametersResult:
    fixed = any(parameter.name == SIM_TIME for parameter in parameters)
    reason = f"{SIM_TIME}: fixed since the node was started" if fixed else ""
    return SetParametersResult(successful=not fixed, reason=reason)
