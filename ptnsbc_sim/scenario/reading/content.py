"""Content that a scenario names outside of its text: tables, maps, and functions of the user.

All of it becomes data of the scenario when it is read: the content of a file `samples`, a trajectory of the user rows
of a `csv` trajectory, a shape of the user offsets. So a flight, its processes, its bag and its re-run need neither the
file nor its rights, and nothing in a bag is executed. A kind that is neither ours nor FILE.py:NAME is looked for among
the entry points of installed packages.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from types import FunctionType
from typing import Any

from ptnsbc_sim.occupancy import COARSEST_M, FINEST_M, MapError, map_text
from ptnsbc_sim.plugins.loader import PluginError, executed, place_of
from ptnsbc_sim.scenario.fields import MOST_SAMPLES
from ptnsbc_sim.scenario.problems import ScenarioError, Tree, shown


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


GROUP = "ptnsbc.plugins"
"""The entry points of installed packages: `trajectory.NAME`, `shape.NAME`, `law.NAME`, `task.NAME` and so on."""

MOST_ROWS = 2000
"""Rows of a trajectory at most, as of any CSV file."""

_TRAJECTORIES = ("circle", "line", "hover", "lissajous", "waypoints", "csv")
_SHAPES = ("v", "line", "column", "grid", "circle", "sphere")
_DURATION_S, _STEP_S = 100.0, 0.1
_LEAST_STEP_S = 0.01
_FARTHEST = 1e6


class FunctionError(PluginError, ScenarioError):
    """A trajectory or shape of the user that cannot be called, or that gives no places."""


def names_function(tree: Tree) -> bool:
    """True if the leader's trajectory or the formation's shape is a function of the user."""
    return _trajectory(tree) is not None or _shape(tree) is not None


def with_code(tree: Tree, folder: Path, given: Iterable[str] = ("law", "plugins")) -> Tree:
    """`tree` with the whole paths of the files of its functions: processes elsewhere read it too.

    Args:
        tree: a scenario.
        folder: where the files are looked for.
        given: dotted keys; only the functions below these are changed.
    """
    keys = set(given)

    def path(kind: str, named: str) -> str:
        key = "law" if kind == "law" else f"plugins.{kind}"
        known = key in keys or key.partition(".")[0] in keys
        return whole_path(kind, named, folder) if known else named

    return _each_function(tree, path)


def without_folder(tree: Tree) -> Tree:
    """`tree` with the mere names of the files of its functions: what comes from outside names no file to execute."""
    return _each_function(tree, lambda _, named: named.replace("\\", "/").rpartition("/")[2])


def named_functions(tree: Tree) -> Tree:
    """The law and the plug-ins that a scenario names, by kind."""
    plugins = tree.get("plugins")
    found = {"law": tree.get("law"), **(plugins if isinstance(plugins, dict) else {})}
    return {kind: named for kind, named in found.items() if isinstance(named, str) and named}


def _each_function(tree: Tree, changed: Callable[[str, str], str]) -> Tree:
    named = {kind: changed(kind, one) for kind, one in named_functions(tree).items()}
    law = {"law": named.pop("law")} if "law" in named else {}
    plugins = {"plugins": {**tree["plugins"], **named}} if named else {}
    return {**tree, **law, **plugins} if law or plugins else tree


def refuse_functions(tree: Tree, source: str) -> None:
    """ScenarioError when a text from outside names code to execute."""
    block = _trajectory(tree) or _shape(tree)
    if block is not None:
        raise ScenarioError(
            f"{source}: kind: {block['kind']}: not here: expected the data that the function gives"
        )


def refuse_new_functions(tree: Tree, given: Mapping[str, Any], source: str) -> None:
    """ScenarioError when a value from outside of a file, as a ROS parameter, names code to execute."""
    if any(key.startswith(("leader", "formation")) for key in given):
        block = _trajectory(tree) or (_shape(tree) if _sets_shape(given) else None)
        if block is not None:
            raise ScenarioError(
                f"{source}: kind: {block['kind']}: not as an override: expected it in a scenario file"
            )


def _sets_shape(given: Mapping[str, Any]) -> bool:
    return any(key.startswith("formation.shape") or key == "formation" for key in given)


def with_trajectory(tree: Tree, source: str, folder: Path) -> Tree:
    """`tree` with rows in the place of a function, called for `duration_s` (100) each `step_s` (0.1).

    Raises:
        FunctionError: the function cannot be loaded or called, or gives no position.
    """
    block = _trajectory(tree)
    if block is None:
        return _with_whole_path(tree, folder)
    where = f"{source}: leader.trajectory"
    function = _function(block["kind"], "trajectory", folder, where)
    known = {key: value for key, value in block.items() if key not in ("kind", "arguments")}
    duration_s = _number(known.pop("duration_s", _DURATION_S), f"{where}.duration_s", 2 * _STEP_S)
    step_s = _number(known.pop("step_s", _STEP_S), f"{where}.step_s", _LEAST_STEP_S)
    count = math.ceil(duration_s / step_s - 1e-9) + 1
    if not 2 <= count <= MOST_ROWS:
        raise FunctionError(
            f"{where}.step_s: {step_s:g}: {count} rows in {duration_s:g} s: expected 2 to {MOST_ROWS}"
        )
    rows = [
        (t, *_numbers(function, (3, 4), {"t": t}, block.get("arguments"), where))
        for t in (round(step_s * k, 9) for k in range(count))
    ]
    if len({len(row) for row in rows}) > 1:
        raise FunctionError(f"{place_of(function)}: expected x, y, z or x, y, z, yaw at every time")
    text = "\n".join(",".join(f"{number:.12g}" for number in row) for row in rows)
    trajectory = {"kind": "csv", "samples": text, **known}
    return {
        **_with_whole_path(tree, folder),
        "leader": {**tree["leader"], "trajectory": trajectory},
    }


def with_shape(tree: Tree, source: str) -> Tree:
    """`tree`, which is whole, with offsets in the place of a function of the number of UAVs.

    Raises:
        FunctionError: the function cannot be loaded or called, or does not give a place for each UAV.
    """
    block = _shape(tree)
    uavs, leader = tree.get("uavs"), tree.get("leader")
    if block is None or not isinstance(uavs, list) or not isinstance(leader, dict):
        return tree
    where = f"{source}: formation.shape"
    formation = tree["formation"]
    if formation.get("offsets_m") is not None:
        raise ScenarioError(f"{where}: expected either shape or offsets_m, not both")
    function = _function(block["kind"], "shape", Path.cwd(), where)
    given = {key: value for key, value in block.items() if key != "kind"}
    ids = [uav.get("id") for uav in uavs if isinstance(uav, dict)]
    followers = [uav for uav in ids if uav != leader.get("id")]
    try:
        places = [list(place) for place in function(len(ids), **given)]
    except Exception as error:
        raise _failed(function, error) from error
    if len(places) != len(ids):
        raise FunctionError(
            f"{place_of(function)}: {len(places)} places: expected one for each of {len(ids)} UAVs, "
            "the leader's first"
        )
    rows = [_checked(place, (3,), function) for place in places]
    offsets = {
        uav: [one - own for one, own in zip(row, rows[0], strict=True)]
        for uav, row in zip(followers, rows[1:], strict=True)
    }
    rest = {key: value for key, value in formation.items() if key != "shape"}
    return {**tree, "formation": {**rest, "offsets_m": offsets}}


def _block(tree: Tree, above: str, key: str, ours: tuple[str, ...]) -> Tree | None:
    parent = tree.get(above)
    block = parent.get(key) if isinstance(parent, dict) else None
    kind = block.get("kind") if isinstance(block, dict) else None
    if not isinstance(kind, str) or kind in ours or not isinstance(block, dict):
        return None
    return block if ".py:" in kind or _entry(key, kind) is not None else None


def _trajectory(tree: Tree) -> Tree | None:
    return _block(tree, "leader", "trajectory", _TRAJECTORIES)


def _shape(tree: Tree) -> Tree | None:
    return _block(tree, "formation", "shape", _SHAPES)


def whole_path(kind: str, named: str, folder: Path) -> str:
    """FILE.py:NAME with the whole path of the file, which is beside the scenario or that of an entry point.

    Raises:
        FunctionError: it is neither FILE.py:NAME nor the name of an entry point, or that does not load.
    """
    name, colon, function = named.rpartition(":")
    if colon:
        return f"{(folder / Path(name).expanduser()).absolute()}:{function}"
    if _entry(kind, named) is None:
        raise FunctionError(
            f"{kind}: {named}: expected FILE.py:NAME, or the name of an entry point {kind}.NAME in {GROUP}"
        )
    found = _function(named, kind, folder, kind)
    return f"{Path(found.__code__.co_filename).absolute()}:{found.__name__}"


def _with_whole_path(tree: Tree, folder: Path) -> Tree:
    """The file of a shape by its whole path: it is called when all files that are extended have been merged."""
    block = _shape(tree)
    if block is None or ".py:" not in block["kind"]:
        return tree
    name, _, function = block["kind"].rpartition(":")
    kind = f"{(folder / Path(name).expanduser()).absolute()}:{function}"
    return {**tree, "formation": {**tree["formation"], "shape": {**block, "kind": kind}}}


def _entry(what: str, name: str) -> Any:
    found = entry_points(group=GROUP, name=f"{what}.{name}")
    return next(iter(found), None)


def _function(kind: str, what: str, folder: Path, where: str) -> FunctionType:
    if ".py:" in kind:
        name, _, wanted = kind.rpartition(":")
        file = (folder / Path(name).expanduser()).absolute()
        try:
            found = executed(file, f"a {what}").get(wanted)
        except PluginError as error:
            raise FunctionError(f"{where}.kind: {error}") from error
    else:
        file, wanted = Path(kind), kind
        try:
            found = _entry(what, kind).load()
        except Exception as error:
            raise FunctionError(
                f"{where}.kind: {kind}: {type(error).__name__}: {error}: expected an entry point that loads"
            ) from error
    if not isinstance(found, FunctionType):
        have = "no such name" if found is None else type(found).__name__
        raise FunctionError(f"{where}.kind: {file}: {wanted}: {have}: expected a function")
    return found


def _numbers(
    function: Callable[..., Any], widths: tuple[int, ...], own: Tree, given: Any, where: str
) -> list[float]:
    if given is not None and not isinstance(given, dict):
        raise FunctionError(f"{where}.arguments: expected a mapping of names to values")
    try:
        found = list(function(*own.values(), **(given or {})))
    except Exception as error:
        raise _failed(function, error) from error
    return _checked(found, widths, function, own)


def _checked(
    found: list[Any], widths: tuple[int, ...], function: Any, own: Tree | None = None
) -> list[float]:
    at = "".join(f" at {key} = {value:g}" for key, value in (own or {}).items())
    expected = " or ".join(map(str, widths))
    try:
        numbers = [float(number) for number in found]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in widths or not all(abs(number) <= _FARTHEST for number in numbers):
        raise FunctionError(
            f"{place_of(function)}: gave {found!r:.80}{at}: expected {expected} numbers, none beyond 1e6"
        )
    return numbers


def _failed(function: Any, error: Exception) -> FunctionError:
    return FunctionError(f"{place_of(function, error)}: {type(error).__name__}: {error}")


def _number(value: Any, where: str, least: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not value >= least:
        raise FunctionError(f"{where}: {value!r}: expected a number of seconds, at least {least:g}")
    return float(value)
