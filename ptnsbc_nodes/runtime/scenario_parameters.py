"""The single values of a scenario as parameters, and a ROS parameter file of them. This module imports no ROS.

A list of numbers is one value. Blocks in lists and values under ids (UAVs, obstacles, tree) have no name of their own.
They are not among the parameters; the parameter file has them in `scenario_text`. No value is in the file twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
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


class ScenarioParameter(NamedTuple):
    """One value, by its dotted key."""

    key: str  # as for `--set`
    value: Value | Numbers
    description: str
    low: float  # -inf without a limit
    high: float  # inf without a limit
    rule: str  # limits that a range cannot express: open ends, choices


def leaves(scenario: Scenario) -> Iterator[ScenarioParameter]:
    """All single values, in the order of the file, with defaults filled in."""
    return _below("", scenario)


def _below(prefix: str, block: BaseModel) -> Iterator[ScenarioParameter]:
    kind = ScenarioFile if isinstance(block, ScenarioFile) else type(block)
    about = " ".join((kind.__doc__ or "").split())
    for name, field in kind.model_fields.items():
        value, key = getattr(block, name), prefix + name
        if isinstance(value, BaseModel):
            yield from _below(f"{key}.", value)
            continue
        numbers = _numbers(value)
        if numbers is not None or isinstance(value, Value):
            description = field.description or f"{name}, of: {about}"
            shown = value if numbers is None else numbers
            yield ScenarioParameter(key, shown, description, *_limits(field))


def _numbers(value: Any) -> Numbers | None:
    """A tuple of numbers as the list that ROS takes: all integers, or all floats."""
    if not isinstance(value, tuple) or not value:
        return None
    if all(type(one) is int for one in value):
        return list(value)
    return (
        [float(one) for one in value] if all(type(one) in (int, float) for one in value) else None
    )


def _limits(field: FieldInfo) -> tuple[float, float, str]:
    """Least and largest value, and in words the limits that these two cannot express."""
    low, high, rules = -math.inf, math.inf, []
    for limit in _constraints(field):
        for name, words in (("gt", "more than"), ("lt", "less than")):
            if getattr(limit, name, None) is not None:
                rules.append(f"{words} {getattr(limit, name):g}")
        low = max(low, *_bounds(limit, "gt", "ge", low))
        high = min(high, *_bounds(limit, "lt", "le", high))
    choices = _choices(field.annotation)
    if choices:
        rules.append(f"one of: {', '.join(choices)}")
    return low, high, "; ".join(rules)


def _constraints(field: FieldInfo) -> Iterator[Any]:
    """The limits of a field, and those inside `... | None`."""
    yield from field.metadata
    for part in get_args(field.annotation):
        yield from getattr(part, "__metadata__", ())


def _bounds(limit: Any, open_end: str, closed_end: str, default: float) -> tuple[float, float]:
    ends = (getattr(limit, name, None) for name in (open_end, closed_end))
    first, second = (default if end is None else float(end) for end in ends)
    return first, second


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
        _indented("scenario_text: |", 4),
        _indented(dump(rest), 6),
        _indented(yaml.safe_dump(named, sort_keys=False, allow_unicode=True, width=10**6), 4),
    ]
    return "\n".join(parts) + "\n"


class GivenParameters(NamedTuple):
    """The values of a scenario in a parameter file."""

    values: dict[str, Any]  # by dotted key
    text: str  # what the values leave out of a whole scenario; empty when the file has only some values


def given_parameters(text: str, source: str) -> GivenParameters:
    """The scenario in a ROS parameter file, as `parameter_file` or `ros2 param dump` writes one.

    What a launcher tells each of its processes by itself, such as `uav` or `lockstep`, is passed over.

    Args:
        text: The file.
        source: Its name, for messages.

    Raises:
        ScenarioError: it is no parameter file, a key is unknown, or two nodes have different values.
    """
    found: dict[str, Any] = {}
    nodes = parse(text, source)
    for node, block in nodes.items():
        values = block.get("ros__parameters") if isinstance(block, dict) else None
        if not isinstance(values, dict):
            raise ScenarioError(f"{source}: {node}: expected ros__parameters with values below")
        for key, value in _flat("", values):
            if key.partition(".")[0] not in (*ScenarioFile.model_fields, *_OF_NODES, _TEXT):
                raise ScenarioError(f"{source}: {node}: {key}: no parameter of a fleet's nodes")
            if found.setdefault(key, value) != value:
                raise ScenarioError(
                    f"{source}: {node}: {key}: {value!r}, but another node has {found[key]!r}: expected "
                    "one value, because all processes of a flight must agree"
                )
    whole = str(found.pop(_TEXT, ""))
    values = {key: value for key, value in found.items() if key.partition(".")[0] not in _OF_NODES}
    return GivenParameters(values, whole)


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


def _indented(text: str, spaces: int) -> str:
    return "\n".join(" " * spaces + line for line in text.splitlines())
