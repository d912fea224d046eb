"""A scenario as a ROS parameter file: one that fits every node of its fleet, on any computer. No ROS in here.

Each single value is a parameter of its own; what has no name of its own, such as the list of UAVs, is
in `scenario_text`. Nothing is in it twice.
"""

from __future__ import annotations

from typing import Any

import yaml

from ptnsbc_nodes.runtime.scenario_parameters import leaves
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.reader import dump, parse


def parameter_file(scenario: Scenario) -> str:
    """The text of the file."""
    rest = parse(scenario.text, scenario.source)
    named: dict[str, Any] = {}
    for leaf in leaves(scenario):
        *above, last = leaf.key.split(".")
        _below(named, above)[last] = leaf.value
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


def _below(tree: dict[str, Any], keys: list[str]) -> dict[str, Any]:
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
