"""The single values of a scenario file, with what the file's types say of each. No ROS in here.

What stands in lists or under ids (UAVs, obstacles, tree) has no name of its own and is not among them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ptnsbc_sim.scenario import Scenario

Value = bool | int | float | str


class ScenarioParameter(NamedTuple):
    """One value, by its dotted key."""

    key: str  # as for `--set`
    value: Value
    description: str
    low: float  # -inf without a limit
    high: float  # inf without a limit
    rule: str  # what a range cannot say: open ends, choices


def leaves(scenario: Scenario) -> Iterator[ScenarioParameter]:
    """All of them, in the order of the file, defaults filled in."""
    return _below("", scenario.file)


def _below(prefix: str, block: BaseModel) -> Iterator[ScenarioParameter]:
    about = " ".join((type(block).__doc__ or "").split())
    for name, field in type(block).model_fields.items():
        value, key = getattr(block, name), prefix + name
        if isinstance(value, BaseModel):
            yield from _below(f"{key}.", value)
        elif isinstance(value, Value):
            description = field.description or f"{name}, of: {about}"
            yield ScenarioParameter(key, value, description, *_limits(field))


def _limits(field: FieldInfo) -> tuple[float, float, str]:
    """Least and largest value, and in words what these two cannot say."""
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
