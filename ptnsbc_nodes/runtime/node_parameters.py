"""The ROS parameters of a flight's processes: how they fly, and every single value of the scenario.

Parameters that define the flight are read-only. Parameters of the scenario can be changed until the node is
configured: all processes of a flight, and its bag, must agree on them.
"""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.comm.graph import FlightOptions
from ptnsbc_nodes.comm.seal import seal_of
from ptnsbc_nodes.runtime.scenario_parameters import (
    OF_SOME_NODES,
    DescribedValue,
    Value,
    is_of_scenario,
    leaves,
)
from ptnsbc_nodes.security.middleware import check_enforced
from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text

SIM_TIME = "use_sim_time"
_OF_RCLPY = ("start_type_description_service",)
_OF_QOS = "qos_overrides."
_LARGEST = sys.float_info.max
_INTEGERS = (-(2**63), 2**63 - 1)

SCENARIO = (
    DescribedValue("scenario", "", "scenario file, or name of a built-in"),
    DescribedValue("scenario_text", "", "the scenario itself, instead of a file"),
    DescribedValue("lockstep", False, "tick with the simulation, not with the clock"),
    DescribedValue("recorded", False, "be ready only when a recorder listens"),
)
UAV = DescribedValue("uav", 0, "id of the UAV; 0: that of the namespace", 0, 254)
BRIDGED = DescribedValue("bridged", False, "flight controllers fly, there is no sim")
AUTOSTART = DescribedValue("autostart", True, "configure and activate without being asked")
FIXED = "fixed since the node was configured; clean it up first"
"""The reason why a value of the scenario may not change."""


class ScenarioParameterError(PtnsbcError):
    """A parameter that a process cannot be started with."""


def overrides(given: Mapping[str, Value | None]) -> list[Parameter]:
    """Options of the command line as parameters for a node; None and False are left out."""
    return [
        Parameter(name, value=value)
        for name, value in given.items()
        if value is not None and value is not False
    ]


class NodeParameters:
    """The parameters of one node: those that define the flight, and every single value of the scenario.

    Args:
        node: Must have declared every parameter that it was given.
        read_only: Those that define the flight, with their defaults.
        bridged: Flight controllers fly, whatever the parameters say.
        fixed: Tells why a value of the scenario may not change any more; empty while it may.

    Raises:
        ParameterError: a value of the wrong type, out of its range, for another kind of node, or of none.
        ScenarioError: the scenario cannot be read with these values.
    """

    def __init__(
        self,
        node: Node,
        read_only: Sequence[DescribedValue],
        *,
        bridged: bool = False,
        fixed: Callable[[], str] = lambda: FIXED,
    ) -> None:
        self._node, self._bridged, self._fixed = node, bridged, fixed
        given = {
            name: _plain(parameter.value)
            for name, parameter in node.get_parameters_by_prefix("").items()
        }
        for one in read_only:
            self._declare(one.with_value(given.get(one.key, one.value)), read_only=True)
        self._changed = {key: value for key, value in given.items() if is_of_scenario(key)}
        self.scenario = self._read({})
        self.uav = 0
        if UAV in read_only:
            last = node.get_namespace().rpartition("/")[2].removeprefix("uav")
            self.uav = int(self["uav"]) or (int(last) if last.isdecimal() else 0)
            if self.uav == 0:
                raise ScenarioParameterError(
                    "parameter uav: not given: expected --uav N, or a namespace /uavN"
                )
            self.scenario.uav(self.uav)  # refuses an id that is not in the file
        known = {SIM_TIME, *_OF_RCLPY, *OF_SOME_NODES, *(one.key for one in read_only)}
        for leaf in leaves(self.scenario):
            known.add(leaf.key)
            self._declare(leaf, read_only=False)
        for key in self._changed.keys() - known:  # a value below an id
            about = ParameterDescriptor(description=f"{key} of the scenario", read_only=True)
            node.undeclare_parameter(key)
            node.declare_parameter(key, self._changed[key], about, ignore_override=True)
        for name in given.keys() - known - self._changed.keys():
            if not name.startswith(_OF_QOS):
                near = difflib.get_close_matches(name, known | self._changed.keys(), n=1)
                hint = f": perhaps {near[0]}" if near else ""
                raise ScenarioParameterError(f"parameter {name}: this node has none{hint}")
        node.add_on_set_parameters_callback(self._on_set)

    def __getitem__(self, name: str) -> Any:
        """The value of a declared parameter."""
        return self._node.get_parameter(name).value

    @property
    def options(self) -> FlightOptions:
        """The options that all processes of a flight share."""
        check_enforced(self.scenario)
        seal = seal_of(self.scenario)
        return FlightOptions(self["lockstep"], self["recorded"], self._is_bridged, seal)

    @property
    def _is_bridged(self) -> bool:
        return self._bridged or bool(self._node.has_parameter("bridged") and self["bridged"])

    def _declare(self, parameter: DescribedValue, *, read_only: bool) -> None:
        key, value, low, high = parameter.key, parameter.value, parameter.low, parameter.high
        if not isinstance(value, str | list) and not low <= value <= high:
            raise ScenarioParameterError(f"parameter {key}: {value}: expected {low:g} to {high:g}")
        about = ParameterDescriptor(
            description=parameter.description,
            additional_constraints=parameter.rule,
            read_only=read_only,
        )
        if (low, high) != (-math.inf, math.inf) and type(value) is float:
            low, high = max(low, -_LARGEST), min(high, _LARGEST)
            about.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        elif (low, high) != (-math.inf, math.inf) and type(value) is int:
            ends = zip((low, high), _INTEGERS, strict=True)
            low_int, high_int = (int(end) if math.isfinite(end) else last for end, last in ends)
            about.integer_range = [IntegerRange(from_value=low_int, to_value=high_int)]
        # A given parameter is declared already, without description and range.
        if self._node.has_parameter(key):
            self._node.undeclare_parameter(key)
        self._node.declare_parameter(key, value, about, ignore_override=True)

    def _read(self, changes: Mapping[str, Any]) -> Scenario:
        """The scenario with the given values and `changes` in place of its own."""
        given = {**self._changed, **changes}
        text, name = self["scenario_text"], self["scenario"]
        if bool(text) == bool(name):
            raise ScenarioParameterError(
                "parameter scenario: expected a scenario file or name (--scenario), or else its "
                f"text in scenario_text, {'not both' if text else 'neither is given'}"
            )
        read = scenario_from_text(text, given) if text else load_scenario(name, given)
        return read.bridged() if self._is_bridged else read

    def _on_set(self, parameters: Iterable[Parameter]) -> SetParametersResult:
        reason = self._refusal({p.name: _plain(p.value) for p in parameters})
        return SetParametersResult(successful=not reason, reason=reason)

    def _refusal(self, given: Mapping[str, Any]) -> str:
        """Take values; the reason why they are refused, empty when they are taken."""
        for name in given:
            if name == "law" or name.startswith("plugins."):
                return f"{name}: names a file to execute: give it in the scenario file"
        changes = {name: value for name, value in given.items() if is_of_scenario(name)}
        # rclpy would move a flying node to another time.
        if (changes or SIM_TIME in given) and (reason := self._fixed()):
            return reason
        if changes:
            try:
                self.scenario = self._read(changes)
            except PtnsbcError as error:
                return " ".join(str(error).split())
            self._changed.update(changes)
        return ""


def _plain(value: Any) -> Any:
    """Arrays as lists, as they are in a scenario file."""
    return value if isinstance(value, Value | None) else list(value)
