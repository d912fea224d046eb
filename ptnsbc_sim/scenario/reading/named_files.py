"""Files that a scenario names for its content: tables of trajectories and shapes, and maps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ptnsbc_sim.occupancy import COARSEST_M, FINEST_M, MapError, map_text
from ptnsbc_sim.scenario.problems import ScenarioError, Tree, shown

MOST_SAMPLES = 200_000
"""Characters of a CSV file at most."""


def _names_file(block: Any) -> bool:
    """True if a block is a trajectory, a shape or a map in a file of its own."""
    named = isinstance(block, dict) and block.get("kind") in ("csv", "file", "stream", "map")
    return named and block.get("file") is not None


def names_table(tree: Any, key: str = "") -> str:
    """The key of the first trajectory or shape that is in a file of its own; empty without one."""
    if _names_file(tree):
        return f"{key}.file"
    found = (names_table(one, where) for where, one in _inside(tree, key))
    return next((name for name in found if name), "")


def _inside(node: Any, key: str) -> list[tuple[str, Any]]:
    """The values in a mapping or list, with the dotted keys."""
    if isinstance(node, list):
        return [(f"{key}[{k}]", one) for k, one in enumerate(node)]
    if isinstance(node, dict):
        return [(f"{key}.{name}" if key else str(name), one) for name, one in node.items()]
    return []


def with_table(tree: Tree, source: str, folder: Path) -> Tree:
    """`tree` with the content of CSV files in the place of their names."""
    return _filled(tree, "", source, folder) if names_table(tree) else tree


def _filled(node: Any, key: str, source: str, folder: Path) -> Any:
    if isinstance(node, list):
        return [_filled(one, f"{key}[{k}]", source, folder) for k, one in enumerate(node)]
    if not isinstance(node, dict):
        return node
    if _names_file(node):
        rest = {name: value for name, value in node.items() if name != "file"}
        read = _map if node["kind"] == "map" else _content
        return {**rest, "samples": read(node, f"{source}: {key}.", folder)}
    return {
        name: _filled(one, f"{key}.{name}" if key else str(name), source, folder)
        for name, one in node.items()
    }


def _place_of(block: Tree, where: str, folder: Path, what: str) -> Path:
    """The path of the file of a block."""
    name = block["file"]
    if not isinstance(name, str) or not name:
        raise ScenarioError(f"{where}: {name!r}: expected the name or path of a {what}")
    return folder / Path(name).expanduser()


def _map(block: Tree, below: str, folder: Path) -> str:
    """The boxes of a map."""
    found, resolution = _place_of(block, f"{below}file", folder, "map"), block.get("resolution_m")
    number = isinstance(resolution, int | float) and not isinstance(resolution, bool)
    edge_m = float(resolution) if number and resolution is not None else 0.0
    if not FINEST_M <= edge_m <= COARSEST_M:
        raise ScenarioError(
            f"{below}resolution_m: {shown(resolution)}: expected a number from {FINEST_M:g} to {COARSEST_M:g} m"
        )
    try:
        text = map_text(found, edge_m)
    except MapError as error:
        raise ScenarioError(f"{below}file: {found}: {error}") from None
    return text


def _content(block: Tree, below: str, folder: Path) -> str:
    where = f"{below}file"
    found = _place_of(block, where, folder, "CSV file")
    try:
        with found.open(encoding="utf-8") as stream:
            text = stream.read(MOST_SAMPLES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name, or no UTF-8
        words = getattr(error, "strerror", None) or "expected UTF-8 text"
        raise ScenarioError(f"{where}: {found}: {words}: expected a readable CSV file") from None
    if len(text) > MOST_SAMPLES:
        raise ScenarioError(f"{where}: {found}: expected at most {MOST_SAMPLES} characters")
    return text
