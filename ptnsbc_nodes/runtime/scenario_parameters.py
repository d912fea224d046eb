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

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.reader import dump, parse

Value = bool | int | float | str
Numbers = list[int] | list[float]


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
    return _below("", scenario.file)


def _below(prefix: str, block: BaseModel) -> Iterator[ScenarioParameter]:
    about = " ".join((type(block).__doc__ or "").split())
    for name, field in type(block).model_fields.items():
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
        _subtree(named, above)[last] = leaf.value
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


def _subtree(tree: dict[str, Any], keys: list[str]) -> dict[str, Any]:
    for key in keys:
        tree = tree.setdefault(key, {})
    return tree


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
