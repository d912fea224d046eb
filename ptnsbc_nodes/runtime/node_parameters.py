"""The ROS parameters of a flight's processes: how they fly, and every single value of the scenario.

Parameters that define the flight are read-only. Parameters of the scenario can be changed until the node is
configured: all processes of a flight, and its bag, must agree on them.
"""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

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
from ptnsbc_nodes.runtime.scenario_parameters import OF_SOME_NODES, ScenarioParameter, Value, leaves
from ptnsbc_nodes.security.middleware import check_enforced
from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text
from ptnsbc_sim.scenario.model import ScenarioFile

SIM_TIME = "use_sim_time"
_OF_RCLPY = ("start_type_description_service",)
_OF_QOS = "qos_overrides."
_LARGEST = sys.float_info.max
_INTEGERS = (-(2**63), 2**63 - 1)


class ScenarioParameterError(PtnsbcError):
    """A parameter that a process cannot be started with."""


class ReadOnlyParameter(NamedTuple):
    """A read-only parameter."""

    name: str
    default: Value
    description: str
    low: float = -math.inf
    high: float = math.inf

    def leaf(self, value: Value) -> ScenarioParameter:
        """The parameter with this value."""
        return ScenarioParameter(self.name, value, self.description, self.low, self.high, "")


SCENARIO = (
    ReadOnlyParameter("scenario", "", "scenario file, or name of a built-in"),
    ReadOnlyParameter("scenario_text", "", "the scenario itself, instead of a file"),
    ReadOnlyParameter("lockstep", False, "tick with the simulation, not with the clock"),
    ReadOnlyParameter("recorded", False, "be ready only when a recorder listens"),
)
UAV = ReadOnlyParameter("uav", 0, "id of the UAV; 0: that of the namespace", 0, 254)
FIXED = "fixed since the node was configured; clean it up first"
"""The reason why a value of the scenario may not change."""
BRIDGED = ReadOnlyParameter("bridged", False, "flight controllers fly, there is no sim")
AUTOSTART = ReadOnlyParameter("autostart", True, "configure and activate without being asked")


def overrides(given: Mapping[str, Value | None]) -> list[Parameter]:
    """Options of the command line as parameters for a node; None and False are left out."""
    return [
        Parameter(name, value=value)
        for name, value in given.items()
        if value is not None and value is not False
    ]


class NodeParameters:
    """Declares the parameters of one node, which must have declared every parameter that it was given.

    Raises:
        ParameterError: a value of the wrong type, out of its range, or for another kind of node.
        ScenarioError: the scenario cannot be read with these values.
    """

    def __init__(
        self, node: Node, fixed: Sequence[ReadOnlyParameter], *, bridged: bool = False
    ) -> None:
        self._node = node
        self._read_only = fixed
        self._bridged = bridged
        self._given = {
            name: _plain(parameter.value)
            for name, parameter in node.get_parameters_by_prefix("").items()
        }
        for one in fixed:
            self._declare(one.leaf(self._value(one.name, one.default)), read_only=True)
        self._changed = {
            key: value
            for key, value in self._given.items()
            if key.partition(".")[0] in ScenarioFile.model_fields
        }
        self.scenario = self._read({})
        self.uav = self._uav() if UAV in fixed else 0

    def declare_scenario(self, fixed: Callable[[], str] = lambda: FIXED) -> None:
        """Declare every single value of the scenario, and refuse parameters that the node does not know.

        Args:
            fixed: tells why a value may not change any more; empty while it may.
        """
        self._fixed = fixed
        for leaf in leaves(self.scenario):
            self._declare(leaf, read_only=False)
        for key in self._changed.keys() - {leaf.key for leaf in leaves(self.scenario)}:
            # A value below an id.
            about = ParameterDescriptor(description=f"{key} of the scenario", read_only=True)
            self._node.undeclare_parameter(key)
            self._node.declare_parameter(key, self._changed[key], about, ignore_override=True)
        self._refuse_unknown()
        self._node.add_on_set_parameters_callback(self._on_set)

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

    def _value(self, name: str, default: Value) -> Value:
        value = self._given.get(name, default)
        if isinstance(default, float) and type(value) is int:
            value = float(value)
        if type(value) is not type(default):
            raise ScenarioParameterError(
                f"parameter {name}: {value!r}: expected {type(default).__name__}"
            )
        return value

    def _declare(self, leaf: ScenarioParameter, *, read_only: bool) -> None:
        if not isinstance(leaf.value, str | list) and not leaf.low <= leaf.value <= leaf.high:
            raise ScenarioParameterError(
                f"parameter {leaf.key}: {leaf.value}: expected {leaf.low:g} to {leaf.high:g}"
            )
        # A given parameter is declared already, without description and range.
        if self._node.has_parameter(leaf.key):
            self._node.undeclare_parameter(leaf.key)
        about = descriptor(leaf, read_only=read_only)
        self._node.declare_parameter(leaf.key, leaf.value, about, ignore_override=True)

    def _refuse_unknown(self) -> None:
        known = {SIM_TIME, *_OF_RCLPY, *OF_SOME_NODES, *(one.name for one in self._read_only)}
        known |= {leaf.key for leaf in leaves(self.scenario)} | self._changed.keys()
        for name in self._given.keys() - known:
            if not name.startswith(_OF_QOS):
                near = difflib.get_close_matches(name, known, n=1)
                hint = f": perhaps {near[0]}" if near else ""
                raise ScenarioParameterError(f"parameter {name}: this node has none{hint}")

    def _uav(self) -> int:
        last = self._node.get_namespace().rpartition("/")[2].removeprefix("uav")
        uav = int(self["uav"]) or (int(last) if last.isdecimal() else 0)
        if uav == 0:
            raise ScenarioParameterError(
                "parameter uav: not given: expected --uav N, or a namespace /uavN"
            )
        self.scenario.uav(uav)  # refuses an id that is not in the file
        return uav

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
        if code := [p.name for p in parameters if p.name == "law" or p.name.startswith("plugins.")]:
            reason = f"{code[0]}: names a file to execute: give it in the scenario file"
            return SetParametersResult(successful=False, reason=reason)
        changes = {p.name: _plain(p.value) for p in parameters if self._of_scenario(p.name)}
        # rclpy would move a flying node to another time.
        if not changes and all(p.name != SIM_TIME for p in parameters):
            return SetParametersResult(successful=True)
        if reason := self._fixed():
            return SetParametersResult(successful=False, reason=reason)
        if not changes:
            return SetParametersResult(successful=True)
        try:
            self.scenario = self._read(changes)
        except PtnsbcError as error:
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()))
        self._changed.update(changes)
        return SetParametersResult(successful=True)

    def _of_scenario(self, name: str) -> bool:
        return name.partition(".")[0] in ScenarioFile.model_fields


def descriptor(leaf: ScenarioParameter, *, read_only: bool) -> ParameterDescriptor:
    """The text that `ros2 param describe` shows of a value."""
    about = ParameterDescriptor(
        description=leaf.description, additional_constraints=leaf.rule, read_only=read_only
    )
    if (leaf.low, leaf.high) == (-math.inf, math.inf):
        return about
    if type(leaf.value) is float:
        low, high = max(leaf.low, -_LARGEST), min(leaf.high, _LARGEST)
        about.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    elif type(leaf.value) is int:
        ends = zip((leaf.low, leaf.high), _INTEGERS, strict=True)
        low_int, high_int = (int(end) if math.isfinite(end) else last for end, last in ends)
        about.integer_range = [IntegerRange(from_value=low_int, to_value=high_int)]
    return about


def _plain(value: Any) -> Any:
    """Arrays as lists, as they are in a scenario file."""
    return value if isinstance(value, Value | None) else list(value)
