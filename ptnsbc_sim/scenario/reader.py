"""Scenario files as trees: search, YAML, `extends` and overrides. `scenario.py` gives them their meaning.

A file may extend another: `extends: paper_5` takes the content of that file, then its own keys. Mappings are merged
key by key, lists and single values are replaced, and `key: null` removes a key.
"""

from __future__ import annotations

import json
import re
import sysconfig
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ptnsbc_sim.occupancy import COARSEST_M, FINEST_M, MapError, map_text
from ptnsbc_sim.scenario.functions import whole_path, with_trajectory
from ptnsbc_sim.scenario.problems import ScenarioError, shown, similar

Tree = dict[Any, Any]

_SUFFIXES = (".yaml", ".yml", ".json")
_MOST_BYTES = 1_000_000
_DEEPEST_EXTENDS = 8

MOST_SAMPLES = 200_000
"""Characters of a CSV file at most."""


class _Loader(yaml.SafeLoader):
    """YAML 1.2 numbers and truth values; duplicate keys, aliases and tags refused."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            raise yaml.composer.ComposerError(
                None, None, "aliases (*name) are not supported, repeat the value", event.start_mark
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str | int):
                raise yaml.constructor.ConstructorError(
                    None, None, "expected text or a number as a key", key_node.start_mark
                )
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f'duplicate key "{key}", keep one of the two', key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


# YAML 1.1, PyYAML's dialect, reads `off` as false, `1e-3` as text and `1:30` as 90.
_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("null", r"~|null|Null|NULL|", "~nN\0"),
    ("int", r"[-+]?[0-9]+", "-+0123456789"),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", "-+.0123456789"),
    ("float", r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", "-+."),
):
    _firsts = [*_first.replace("\0", ""), *([""] if "\0" in _first else [])]
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), _firsts
    )


def _plain_int(loader: yaml.SafeLoader, node: Any) -> int:
    return int(loader.construct_scalar(node))  # 007 is seven, not octal


_Loader.add_constructor("tag:yaml.org,2002:int", _plain_int)


def parse(text: str, source: str) -> Tree:
    """The mapping that a scenario text holds."""
    if len(text) > _MOST_BYTES:
        raise ScenarioError(f"{source}: over {_MOST_BYTES} bytes: expected a scenario file")
    try:
        tree = yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise ScenarioError(f"{source}: {where}{_one_line(error.problem)}") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ScenarioError(f"{source}: not YAML: {_one_line(error)}") from None
    if not isinstance(tree, dict):
        found = "nothing" if tree is None else type(tree).__name__
        raise ScenarioError(f"{source}: {found}: expected a mapping that starts with name:")
    return tree


def parse_json(text: str, source: str) -> Tree:
    """The mapping that a scenario in JSON holds; a key of digits is an id."""

    def mapping(pairs: list[tuple[str, Any]]) -> Tree:
        found: Tree = {}
        for key, value in pairs:
            if key in found:
                raise ScenarioError(f'{source}: duplicate key "{key}", keep one of the two')
            found[key] = value
        return {int(key) if key.isdecimal() else key: value for key, value in found.items()}

    def constant(word: str) -> Any:
        raise ScenarioError(f"{source}: {word}: expected a finite number")

    try:
        tree = json.loads(text, object_pairs_hook=mapping, parse_constant=constant)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise ScenarioError(f"{source}: {where}: {error.msg}: expected JSON") from None
    except (RecursionError, ValueError) as error:
        raise ScenarioError(f"{source}: not JSON: {_one_line(error)}") from None
    if not isinstance(tree, dict):
        raise ScenarioError(f"{source}: {type(tree).__name__}: expected a mapping with a name")
    return tree


def _one_line(text: object) -> str:
    return " ".join(str(text).split())


def folders() -> list[Path]:
    """Folders in which a scenario given by name is searched: source tree, installed copy, current folder."""
    root = Path(__file__).resolve().parents[2]
    # pip and colcon install the code into PREFIX/lib/pythonX.Y/site-packages, Debian's pip somewhat deeper.
    prefixes = dict.fromkeys((*root.parents[2:3], Path(sysconfig.get_path("data"))))
    shared = [prefix / "share" / "ptnsbc" / "scenarios" for prefix in prefixes]
    return [root / "scenarios", *shared, Path.cwd() / "scenarios", Path.cwd()]


def available() -> list[str]:
    """The names of the scenarios that can be given without a path."""
    named = folders()[:-1]  # the current directory may hold any other YAML
    found = {path.stem for folder in named for path in folder.glob("*.yaml")}
    return sorted(found)


def find(name: str | Path, beside: Path | None = None) -> Path:
    """The file of a scenario, given by path or by name without suffix."""
    given = Path(name).expanduser()
    if len(given.parts) > 1:
        path = given if beside is None or given.is_absolute() else beside / given
        if _is_file(path):
            return path
        raise ScenarioError(f"{path}: no such scenario file; {_names(given.stem)}")
    suffixes = ("",) if given.suffix in _SUFFIXES else _SUFFIXES
    # A file named in full is more likely the one lying here than a shipped one.
    here = [beside or Path.cwd()] if given.suffix in _SUFFIXES or beside else []
    for folder in here + folders():
        for suffix in suffixes:
            path = folder / f"{given}{suffix}"
            if _is_file(path):
                return path
    raise ScenarioError(f"{given}: no scenario of this name; {_names(given.stem)}")


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long, or with a NUL
        return False


def _names(word: str) -> str:
    names = available()
    return similar(word, names) if names else "none are installed, give a path"


def read_text(path: Path) -> str:
    """The text of a scenario file, as YAML: that of a JSON file is translated."""
    text = _text_of(path)
    return dump(parse_json(text, str(path))) if path.suffix == ".json" else text


def _text_of(path: Path) -> str:
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ScenarioError(f"{path}: over {_MOST_BYTES} bytes: expected a scenario file")
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path}: byte {error.start}: expected UTF-8 text") from None
    except OSError as error:
        raise ScenarioError(
            f"{path}: {error.strerror or error}: expected a readable file"
        ) from None


def _other_trajectory(key: object, below: Tree, value: Tree) -> bool:
    """Whether `value` is a trajectory of another kind, which has other keys."""
    return key == "trajectory" and value.get("kind", below.get("kind")) != below.get("kind")


def merged(base: Tree, own: Tree) -> Tree:
    """`own` over `base`: mappings key by key, everything else and another kind of trajectory whole, null removes."""
    result = dict(base)
    for key, value in own.items():
        below = result.get(key)
        if value is None:
            result.pop(key, None)
        elif isinstance(value, dict) and isinstance(below, dict):
            result[key] = merged({} if _other_trajectory(key, below, value) else below, value)
        else:
            result[key] = value
    return result


def _names_file(block: Any) -> bool:
    """Whether a block is a trajectory, a shape or a map in a file of its own."""
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
    """Where the file of a block is."""
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


def extended(tree: Tree, source: str, folder: Path, depth: int = 0) -> Tree:
    """`tree` with what it extends, and files that it names, filled in."""
    tree = with_trajectory(with_table(tree, source, folder), source, folder)
    if "extends" not in tree:
        return tree
    own = {key: value for key, value in tree.items() if key != "extends"}
    name = tree["extends"]
    if not isinstance(name, str) or not name:
        raise ScenarioError(f"{source}: extends: {name!r}: expected the name or path of a scenario")
    if depth >= _DEEPEST_EXTENDS:
        raise ScenarioError(f"{source}: extends: {name}: expected no circle of files")
    try:
        path = find(name, beside=folder)
    except ScenarioError as error:
        raise ScenarioError(f"{source}: extends: {error}") from None
    base = parse(read_text(path), str(path))
    base = with_code(base, path.parent)
    return merged(extended(base, str(path), path.parent, depth + 1), own)


def _step(node: Any, key: str, path: str, source: str) -> Any:
    """One segment of a dotted override as the key or index it means in `node`."""
    if isinstance(node, list):
        if not key.isdigit() or int(key) >= len(node):
            raise ScenarioError(
                f"{source}: override {path}: {key}: expected an index below {len(node)}"
            )
        return int(key)
    if not isinstance(node, dict):
        raise ScenarioError(f"{source}: override {path}: {key}: there is nothing below this key")
    return int(key) if key.isdigit() and key not in node else key


def overridden(tree: Tree, overrides: Mapping[str, Any], source: str) -> Tree:
    """`tree` with dotted keys (`gains.profile`, `uavs[2].position_m`) set; a None is left out."""
    return with_keys(yaml.load(dump(tree), Loader=_Loader), overrides, source)


def with_keys(tree: Tree, overrides: Mapping[str, Any], source: str) -> Tree:
    """`tree`, changed in place, with dotted keys set; a None is left out."""
    for path, value in overrides.items():
        if value is None:
            continue
        keys = [key for key in re.split(r"[.\[\]]+", path) if key]
        if not keys:
            raise ScenarioError(f'{source}: override "{path}": expected a dotted key')
        node: Any = tree
        for key in keys[:-1]:
            step = _step(node, key, path, source)
            node = node[step] if isinstance(node, list) else node.setdefault(step, {})
        node[_step(node, keys[-1], path, source)] = value
    return tree


def plain(value: Any) -> Any:
    """A value from Python as YAML holds it: arrays, tuples and NumPy numbers become lists and numbers."""
    if isinstance(value, Mapping):
        return {plain(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if value is not None and not isinstance(value, str | bool | int | float):
        raise ScenarioError(
            f"{shown(value)}: {type(value).__name__}: expected a number, text, a list or a mapping"
        )
    return value


class _WithoutAliases(yaml.SafeDumper):
    """Writes a value that stands in two places twice, because `parse` reads no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def dump(tree: Tree) -> str:
    """`tree` as YAML text that `parse` reads back."""
    options: dict[str, Any] = {"sort_keys": False, "allow_unicode": True, "width": 120}
    text: str = yaml.dump(tree, Dumper=_WithoutAliases, **options)
    return text
