"""Content that a scenario names outside of its text: tables, maps, and functions of the user.

All of it becomes data of the scenario when it is read: the content of a file `samples`, a trajectory of the user rows
of a `file` trajectory, a shape of the user offsets. So a flight, its processes, its bag and its re-run need neither the
file nor its rights, and nothing in a bag is executed. A kind that is neither ours nor FILE.py:NAME is looked for among
the entry points of installed packages.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from importlib.metadata import entry_points
from pathlib import Path
from types import FunctionType
from typing import Any, get_args

from pydantic_core import PydanticCustomError

from ptnsbc_io.point_cloud_file import PointCloudFileError
from ptnsbc_sim.occupancy import COARSEST_M, FINEST_M, map_text
from ptnsbc_sim.plugins.loader import PluginError, named_in, place_of
from ptnsbc_sim.scenario.fields import MOST_SAMPLES, without_unit
from ptnsbc_sim.scenario.mission.path_files import text_of, waypoints_of
from ptnsbc_sim.scenario.mission.shapes import ShapeBlock, offsets_of
from ptnsbc_sim.scenario.mission.stream import setpoints_of
from ptnsbc_sim.scenario.mission.trajectories import MOST_POINTS, LeaderTrajectoryBlock, samples_of
from ptnsbc_sim.scenario.problems import ScenarioError, Tree, shown

_MOST_BYTES = 100_000_000  # of a file


def blocks_below(node: Any, key: str = "") -> Iterator[tuple[str, Tree]]:
    """Every mapping below a node, by its dotted key; a mapping comes before those in it."""
    if isinstance(node, list):
        for index, item in enumerate(node):
            yield from blocks_below(item, f"{key}[{index}]")
    elif isinstance(node, dict):
        yield key, node
        for name, value in node.items():
            yield from blocks_below(value, f"{key}.{name}" if key else str(name))


def _tables(tree: Tree) -> Iterator[tuple[str, Tree]]:
    """The trajectories, shapes and maps in files of their own, by their dotted keys."""
    for key, block in blocks_below(tree):
        kind = block.get("kind")
        if kind in ("csv", "file", "stream", "map") and block.get("file") is not None:
            yield key, block


def names_table(tree: Tree) -> str:
    """The key of the first file that a tree names; empty without one."""
    return next((f"{key}.file" for key, _ in _tables(tree)), "")


def with_table(tree: Tree, source: str, folder: Path) -> Tree:
    """`tree` with the content of CSV files and maps in the place of their names."""
    if names_table(tree):
        tree = copy.deepcopy(tree)
        for key, block in list(_tables(tree)):
            block |= _content_of(block, f"{source}: {key}", folder)
            del block["file"]
    return tree


def _content_of(block: Tree, where: str, folder: Path) -> Tree:
    """The keys that the file of a block gives to it."""
    name, kind = block["file"], block["kind"]
    if not isinstance(name, str) or not name:
        raise ScenarioError(f"{where}.file: {name!r}: expected the name or path of a file")
    path = folder / Path(name).expanduser()
    try:
        with path.open("rb") as stream:
            data = stream.read(_MOST_BYTES + 1)
        if len(data) > _MOST_BYTES:
            raise ValueError(f"expected at most {_MOST_BYTES} bytes")
        if kind == "map":
            key = f"{where}.resolution_m"
            edge_m = _quantity(block.get("resolution_m"), "m", key, FINEST_M, COARSEST_M)
            return {"samples": map_text(path.suffix.lower(), data, edge_m)}
        text = text_of(data, block.get("drone"))
        if len(text) > MOST_SAMPLES:
            raise ValueError(f"expected at most {MOST_SAMPLES} characters: leave rows out")
        if kind == "stream":
            setpoints_of(text)
        elif where.endswith("shape"):
            offsets_of(text)
        elif text.lstrip().startswith("{"):
            found = waypoints_of(text)
            return {**found, "speed_m_s": block.get("speed_m_s") or found["speed_m_s"]}
        else:
            # The values are validated with the scenario: here counts which of them there is.
            samples_of(text, block.get("speed_m_s") and 1.0, block.get("rate_hz") and 1.0)
    except OSError as error:
        why = f"{error.strerror}: expected a readable file"
        raise ScenarioError(f"{where}.file: {path}: {why}") from None
    except (PointCloudFileError, ValueError) as error:
        raise ScenarioError(f"{where}.file: {path}: {error}") from None
    return {"samples": text}


GROUP = "ptnsbc.plugins"
"""The entry points of installed packages: `trajectory.NAME`, `shape.NAME`, `law.NAME`, `task.NAME` and so on."""

_TRAJECTORIES = get_args(get_args(LeaderTrajectoryBlock)[0])
_OURS = {
    key: [kind for block in blocks for kind in get_args(block.model_fields["kind"].annotation)]
    for key, blocks in {"trajectory": _TRAJECTORIES, "shape": (ShapeBlock,)}.items()
}
_ABOVE = {"trajectory": "leader", "shape": "formation"}
_DURATION_S, _STEP_S = 100.0, 0.1
_LEAST_STEP_S = 0.01
_FARTHEST = 1e6


def with_code(tree: Tree, folder: Path, given: Iterable[str] = ("law", "plugins")) -> Tree:
    """`tree` with the whole paths, from a folder, of the files of its functions below the given keys.

    Processes elsewhere read it too.
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


def _each_function(tree: Tree, changed: Callable[[str, str], str]) -> Tree:
    plugins = tree.get("plugins")
    found = {"law": tree.get("law"), **(plugins if isinstance(plugins, dict) else {})}
    named = {
        kind: changed(kind, one) for kind, one in found.items() if isinstance(one, str) and one
    }
    law = {"law": named.pop("law")} if "law" in named else {}
    changes = {"plugins": {**tree["plugins"], **named}} if named else {}
    return {**tree, **law, **changes}


def refuse_functions(
    tree: Tree,
    source: str,
    keys: Iterable[str] = ("trajectory", "shape"),
    why: str = "here: expected the data that it gives",
) -> None:
    """ScenarioError when a text from outside names code to execute."""
    for key in keys:
        if (block := _of_user(tree, key)) is not None:
            raise ScenarioError(f"{source}: kind: {block['kind']}: not {why}")


def refuse_new_functions(tree: Tree, given: Mapping[str, Any], source: str) -> None:
    """ScenarioError when a value from outside of a file, as a ROS parameter, names code to execute."""
    shape = any(key.startswith("formation.shape") or key == "formation" for key in given)
    keys = ("trajectory", "shape") if shape else ("trajectory",)
    refuse_functions(tree, source, keys, "as an override: expected it in a scenario file")


def with_trajectory(tree: Tree, source: str, folder: Path) -> Tree:
    """`tree` with rows in the place of a function, called for `duration_s` (100) each `step_s` (0.1).

    Raises:
        ScenarioError: the function cannot be loaded or called, or gives no position.
    """
    block = _of_user(tree, "trajectory")
    if block is None:
        return _with_whole_path(tree, folder)
    where = f"{source}: leader.trajectory"
    function = _function(block["kind"], "trajectory", folder, where)
    known = {key: value for key, value in block.items() if key not in ("kind", "arguments")}
    duration_s = _quantity(
        known.pop("duration_s", _DURATION_S), "s", f"{where}.duration_s", 2 * _STEP_S, _FARTHEST
    )
    step_s = _quantity(
        known.pop("step_s", _STEP_S), "s", f"{where}.step_s", _LEAST_STEP_S, _FARTHEST
    )
    count = math.ceil(duration_s / step_s - 1e-9) + 1
    if not 2 <= count <= MOST_POINTS:
        raise ScenarioError(
            f"{where}.step_s: {step_s:g}: {count} rows in {duration_s:g} s: expected 2 to {MOST_POINTS}"
        )
    arguments = block.get("arguments") or {}
    if not isinstance(arguments, dict):
        raise ScenarioError(f"{where}.arguments: expected a mapping of names to values")
    rows = []
    for k in range(count):
        t = round(step_s * k, 9)
        row = _numbers(_called(function, t, arguments), (3, 4), function, f" at t = {t:g}")
        rows.append((t, *row))
    if len({len(row) for row in rows}) > 1:
        raise ScenarioError(f"{place_of(function)}: expected x, y, z or x, y, z, yaw at every time")
    text = "\n".join(",".join(f"{number:.12g}" for number in row) for row in rows)
    trajectory = {"kind": "file", "samples": text, **known}
    return {
        **_with_whole_path(tree, folder),
        "leader": {**tree["leader"], "trajectory": trajectory},
    }


def with_shape(tree: Tree, source: str) -> Tree:
    """`tree`, which is whole, with offsets in the place of a function of the number of UAVs.

    Raises:
        ScenarioError: the function cannot be loaded or called, or does not give a place for each UAV.
    """
    block = _of_user(tree, "shape")
    uavs, leader = tree.get("uavs"), tree.get("leader")
    if block is None or not isinstance(uavs, list) or not isinstance(leader, dict):
        return tree
    where = f"{source}: formation.shape"
    formation = tree["formation"]
    if formation.get("offsets_m") is not None:
        raise ScenarioError(f"{where}: expected either shape or offsets_m, not both")
    function = _function(block["kind"], "shape", Path.cwd(), where)
    arguments = {key: value for key, value in block.items() if key != "kind"}
    ids = [uav.get("id") for uav in uavs if isinstance(uav, dict)]
    # ids that do not fit together are named when the offsets are checked against them
    followers = [uav for uav in ids if isinstance(uav, int) and uav != leader.get("id")]
    places = _called(function, len(ids), arguments)
    if len(places) != len(ids):
        raise ScenarioError(
            f"{place_of(function)}: {len(places)} places: expected one for each of {len(ids)} UAVs, "
            "the leader's first"
        )
    rows = [_numbers(place, (3,), function) for place in places]
    offsets = {
        uav: [coordinate - origin for coordinate, origin in zip(row, rows[0], strict=True)]
        for uav, row in zip(followers, rows[1:], strict=False)
    }
    rest = {key: value for key, value in formation.items() if key != "shape"}
    return {**tree, "formation": {**rest, "offsets_m": offsets}}


def _of_user(tree: Tree, key: str) -> Tree | None:
    """The block `trajectory` or `shape` whose kind is a function of the user."""
    parent = tree.get(_ABOVE[key])
    block = parent.get(key) if isinstance(parent, dict) else None
    kind = block.get("kind") if isinstance(block, dict) else None
    if not isinstance(kind, str) or kind in _OURS[key]:
        return None
    return block if ".py:" in kind or _entry(key, kind) is not None else None


def whole_path(kind: str, named: str, folder: Path) -> str:
    """FILE.py:NAME with the whole path of the file, which is beside the scenario or that of an entry point.

    Raises:
        ScenarioError: it is neither FILE.py:NAME nor the name of an entry point, or that does not load.
    """
    if ":" in named:
        return _beside(named, folder)
    if _entry(kind, named) is None:
        raise ScenarioError(
            f"{kind}: {named}: expected FILE.py:NAME, or the name of an entry point {kind}.NAME in {GROUP}"
        )
    function = _function(named, kind, folder, kind)
    return f"{Path(function.__code__.co_filename).absolute()}:{function.__name__}"


def _with_whole_path(tree: Tree, folder: Path) -> Tree:
    """The file of a shape by its whole path: it is called when all files that are extended have been merged."""
    block = _of_user(tree, "shape")
    if block is None or ".py:" not in block["kind"]:
        return tree
    shape = {**block, "kind": _beside(block["kind"], folder)}
    return {**tree, "formation": {**tree["formation"], "shape": shape}}


def _beside(named: str, folder: Path) -> str:
    """FILE.py:NAME with the whole path of the file, from a folder."""
    name, _, function = named.rpartition(":")
    return f"{(folder / Path(name).expanduser()).absolute()}:{function}"


def _entry(what: str, name: str) -> Any:
    found = entry_points(group=GROUP, name=f"{what}.{name}")
    return next(iter(found), None)


def _function(kind: str, what: str, folder: Path, where: str) -> FunctionType:
    if ".py:" in kind:
        file, _, name = _beside(kind, folder).rpartition(":")
        try:
            return named_in(Path(file), name, f"a {what}")
        except PluginError as error:
            raise ScenarioError(f"{where}.kind: {error}") from error
    try:
        found = _entry(what, kind).load()
    except Exception as error:
        raise ScenarioError(
            f"{where}.kind: {kind}: {type(error).__name__}: {error}: expected an entry point that loads"
        ) from error
    if not isinstance(found, FunctionType):
        raise ScenarioError(f"{where}.kind: {kind}: {type(found).__name__}: expected a function")
    return found


def _called(function: FunctionType, given: float, arguments: Tree) -> list[Any]:
    """The list that a function of the user gives."""
    try:
        return list(function(given, **arguments))
    except Exception as error:
        raise ScenarioError(
            f"{place_of(function, error)}: {type(error).__name__}: {error}"
        ) from error


def _numbers(
    given: Any, widths: tuple[int, ...], function: FunctionType, at: str = ""
) -> list[float]:
    try:
        numbers = [float(number) for number in given]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in widths or not all(abs(number) <= _FARTHEST for number in numbers):
        expected = " or ".join(map(str, widths))
        raise ScenarioError(
            f"{place_of(function)}: gave {given!r:.80}{at}: expected {expected} numbers, none beyond 1e6"
        )
    return numbers


def _quantity(value: Any, unit: str, where: str, low: float, high: float) -> float:
    """A number of a block that is needed before the scenario is validated, with or without its unit."""
    number = value
    with suppress(PydanticCustomError):
        number = without_unit(value, unit)
    if isinstance(number, bool) or not isinstance(number, int | float) or not low <= number <= high:
        raise ScenarioError(
            f"{where}: {shown(value)}: expected a number from {low:g} to {high:g} {unit}"
        )
    return float(number)
