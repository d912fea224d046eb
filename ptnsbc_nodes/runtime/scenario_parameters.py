"""The single values of a scenario as parameters, and a ROS parameter file of them. This module imports no ROS.

A list of numbers is one value. Blocks in lists and values under ids (UAVs, obstacles, tree) have no name of their own.
They are not among the parameters; the parameter file has them in `scenario_text`. No value is in the file twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain
from textwrap import indent
from typing import Any, Literal, NamedTuple, get_args, get_origin

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ptnsbc_sim.scenario import Scenario, ScenarioError
from ptnsbc_sim.scenario.model import ScenarioFile
from ptnsbc_sim.scenario.reading.reader import dump, parse

Value = bool | int | float | str
Numbers = list[int] | list[float]

OF_SOME_NODES = ("uav", "bridged", "autostart", "signing_key", "allow_arming")
"""Parameters that only some nodes have: one parameter file serves all nodes of a fleet."""
_OF_NODES = (
    *("scenario", "lockstep", "recorded", "use_sim_time", "start_type_description_service"),
    *("qos_overrides", *OF_SOME_NODES),
)
_TEXT = "scenario_text"


class DescribedValue(NamedTuple):
    """One parameter: its value, and what `ros2 param describe` tells of it."""

    key: str  # dotted, as for `--set`
    value: Value | Numbers
    description: str
    low: float = -math.inf
    high: float = math.inf
    rule: str = ""  # limits that a range cannot express: open ends, choices

    def with_value(self, value: Any) -> DescribedValue:
        """The same with another value; ScenarioError for one of another type."""
        if isinstance(self.value, float) and type(value) is int:
            value = float(value)
        if type(value) is not type(self.value):
            expected = type(self.value).__name__
            raise ScenarioError(f"parameter {self.key}: {value!r}: expected {expected}")
        return self._replace(value=value)


def is_of_scenario(key: str) -> bool:
    """True if a parameter of this name is a value of the scenario."""
    return key.partition(".")[0] in ScenarioFile.model_fields


def leaves(block: BaseModel, prefix: str = "") -> Iterator[DescribedValue]:
    """All single values of a scenario, in the order of the file, with defaults filled in."""
    kind = ScenarioFile if isinstance(block, ScenarioFile) else type(block)
    about = " ".join((kind.__doc__ or "").split())
    for name, field in kind.model_fields.items():
        value, key = getattr(block, name), prefix + name
        if isinstance(value, BaseModel):
            yield from leaves(value, f"{key}.")
            continue
        if isinstance(value, tuple) and value and {*map(type, value)} <= {int, float}:
            # ROS takes a list of integers, or of floats.
            value = list(value if {*map(type, value)} == {int} else map(float, value))
        elif not isinstance(value, Value):
            continue
        description = field.description or f"{name}, of: {about}"
        yield DescribedValue(key, value, description, *_limits(field))


_ENDS = {"gt": "more than", "lt": "less than", "ge": "", "le": ""}


def _limits(field: FieldInfo) -> tuple[float, float, str]:
    """Least and largest value, and in words the limits that these two cannot express."""
    low, high, rules = -math.inf, math.inf, []
    inside = (getattr(part, "__metadata__", ()) for part in get_args(field.annotation))
    for limit in (*field.metadata, *chain.from_iterable(inside)):  # those of `... | None` as well
        for name, words in _ENDS.items():
            end = getattr(limit, name, None)
            if end is None:
                continue
            if words:
                rules.append(f"{words} {end:g}")
            if name in ("gt", "ge"):
                low = max(low, float(end))
            else:
                high = min(high, float(end))
    choices = _choices(field.annotation)
    if choices:
        rules.append(f"one of: {', '.join(choices)}")
    return low, high, "; ".join(rules)


def _choices(annotation: Any) -> tuple[str, ...]:
    if get_origin(annotation) is Literal:
        return tuple(map(str, get_args(annotation)))
    found = (_choices(part) for part in get_args(annotation))
    return next((choices for choices in found if choices), ())


def parameter_file(scenario: Scenario) -> str:
    """The text of a parameter file that fits every node of the fleet, on any computer."""
    rest = parse(scenario.text, scenario.source)
    named: dict[str, Any] = {}
    for leaf in leaves(scenario):
        *above, last = leaf.key.split(".")
        block = named
        for key in above:
            block = block.setdefault(key, {})
        block[last] = leaf.value
        _remove(rest, [*above, last])
    parts = [
        f"# {scenario.name} as ROS parameters, for all its nodes: --ros-args --params-file THIS",
        "/**:",
        "  ros__parameters:",
        indent("scenario_text: |", 4 * " "),
        indent(dump(rest).rstrip("\n"), 6 * " "),
        indent(
            yaml.safe_dump(named, sort_keys=False, allow_unicode=True, width=10**6).rstrip("\n"),
            4 * " ",
        ),
    ]
    return "\n".join(parts) + "\n"


class GivenParameters(NamedTuple):
    """The values of a scenario in a parameter file."""

    values: dict[str, Any]  # by dotted key
    text: str  # what the values leave out of a whole scenario; empty when the file has only some values


def given_parameters(text: str, source: str) -> GivenParameters:
    """The scenario in a ROS parameter file, as `parameter_file` or `ros2 param dump` writes one.

    What a launcher tells each of its processes by itself, such as `uav` or `lockstep`, is passed over. `source` is the
    name of the file, for messages.

    Raises:
        ScenarioError: it is no parameter file, a key is unknown, or two nodes have different values.
    """
    found: dict[str, Any] = {}
    for node, block in parse(text, source).items():
        values = block.get("ros__parameters") if isinstance(block, dict) else None
        if not isinstance(values, dict):
            raise ScenarioError(f"{source}: {node}: expected ros__parameters with values below")
        for key, value in _flat("", values):
            if not is_of_scenario(key) and key.partition(".")[0] not in (*_OF_NODES, _TEXT):
                raise ScenarioError(f"{source}: {node}: {key}: no parameter of a fleet's nodes")
            if found.setdefault(key, value) != value:
                raise ScenarioError(
                    f"{source}: {node}: {key}: {value!r}, but another node has {found[key]!r}: expected "
                    "one value, because all processes of a flight must agree"
                )
    values = {key: value for key, value in found.items() if is_of_scenario(key)}
    return GivenParameters(values, str(found.get(_TEXT, "")))


def _flat(prefix: str, tree: dict[Any, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(f"{prefix}{name}.", value)
        else:
            yield f"{prefix}{name}", value


def _remove(tree: Any, keys: list[str]) -> None:
    """Take a value out, and the mappings that are empty without it."""
    first, *others = keys
    if not isinstance(tree, dict) or first not in tree:
        return
    if others:
        _remove(tree[first], others)
    if not others or tree[first] == {}:
        del tree[first]
