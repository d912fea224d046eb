"""Scenario files as trees: search, YAML, `extends` and overrides. `scenario.py` gives them their meaning.

A file may extend another: `extends: paper_5` takes the content of that file, then its own keys. Mappings are merged
key by key, lists and single values are replaced, and `key: null` removes a key.
"""

from __future__ import annotations

import json
import os
import re
import sysconfig
from collections.abc import Iterable, Mapping
from copy import deepcopy
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ptnsbc_sim.scenario.problems import ScenarioError, Tree, shown, similar
from ptnsbc_sim.scenario.reading.content import with_code, with_table, with_trajectory

_SUFFIXES = (".yaml", ".yml", ".json")
_MOST_BYTES = 1_000_000
_DEEPEST_EXTENDS = 8


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
_loaded = lru_cache(16)(partial(yaml.load, Loader=_Loader))  # of the same text; callers take a copy


def parse(text: str, source: str, begins: str = "name") -> Tree:
    """The mapping that a scenario text holds, or another one that begins with another key."""
    if len(text) > _MOST_BYTES:
        raise ScenarioError(f"{source}: over {_MOST_BYTES} bytes: expected a scenario file")
    try:
        tree = deepcopy(_loaded(text))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise ScenarioError(f"{source}: {where}{_one_line(error.problem)}") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ScenarioError(f"{source}: not YAML: {_one_line(error)}") from None
    if not isinstance(tree, dict):
        found = "nothing" if tree is None else type(tree).__name__
        raise ScenarioError(f"{source}: {found}: expected a mapping that starts with {begins}:")
    return tree


def parse_json(text: str, source: str) -> Tree:
    """The mapping that a scenario in JSON holds; a key of digits is an id."""

    def mapping(pairs: list[tuple[str, Any]]) -> Tree:
        entries: Tree = {}
        for key, value in pairs:
            if key in entries:
                raise ScenarioError(f'{source}: duplicate key "{key}", keep one of the two')
            entries[key] = value
        return {int(key) if key.isdecimal() else key: value for key, value in entries.items()}

    def constant(word: str) -> Any:
        raise ScenarioError(f"{source}: {word}: expected a finite number")

    try:
        tree = json.loads(text, object_pairs_hook=mapping, parse_constant=constant)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise ScenarioError(f"{source}: {where}: {error.msg}: expected JSON") from None
    except (RecursionError, ValueError) as error:
        raise ScenarioError(f"{source}: not JSON: {_one_line(error)}") from None
    return tree


def _one_line(text: object) -> str:
    return " ".join(str(text).split())


def folders() -> list[Path]:
    """Folders in which a scenario given by name is searched: source tree, installed copy, current folder."""
    root = Path(__file__).resolve().parents[3]
    # pip and colcon install the code into PREFIX/lib/pythonX.Y/site-packages, Debian's pip somewhat deeper.
    prefixes = dict.fromkeys((*root.parents[2:3], Path(sysconfig.get_path("data"))))
    shared = [prefix / "share" / "ptnsbc" / "scenarios" for prefix in prefixes]
    return [root / "scenarios", *shared, Path.cwd() / "scenarios", Path.cwd()]


def available(below: str = "") -> list[str]:
    """The names of the scenarios that can be given without a path, or of the files in a folder beside them."""
    named = folders()[:-1]  # the current directory may hold any other YAML
    return sorted({path.stem for folder in named for path in (folder / below).glob("*.yaml")})


def find(name: str | Path, beside: Path | None = None) -> Path:
    """The file of a scenario, given by path or by name without suffix."""
    try:
        given = Path(name).expanduser()
    except TypeError:
        expected = "a scenario, its name or file, or a mapping with its keys"
        raise ScenarioError(f"{shown(name)}: expected {expected}") from None
    if not given.name:
        raise ScenarioError(f'"{name}": expected the name or the file of a scenario')
    in_full = given.suffix in _SUFFIXES
    if len(given.parts) > 1:
        places = [given if beside is None or given.is_absolute() else beside / given]
    else:
        suffixes = ("",) if in_full else _SUFFIXES
        # A file named in full is more likely the one lying here than a shipped one.
        here = [beside or Path.cwd()] if in_full or beside else []
        places = [folder / f"{given}{end}" for folder in here + folders() for end in suffixes]
    for path in places:
        if os.path.isfile(path):  # False for a name that is too long, or with a NUL
            return path
    if os.path.isdir(places[0]) or os.path.isdir(given):
        raise ScenarioError(f"{given}: a folder: expected a scenario file")
    names = available()
    if not in_full and len(given.parts) == 1:
        raise ScenarioError(f"{given}: no scenario of this name; {similar(given, names)}")
    around = os.listdir(folder) if os.path.isdir(folder := places[0].parent) else []
    files = sorted(name for name in around if name.endswith(_SUFFIXES))
    near = similar(given.name, [*files, *names])
    advice = near if near.startswith("did") else "expected one, or a name of ptnsbc scenarios"
    raise ScenarioError(f"{given}: no such scenario file; {advice}")


def read_text(path: Path) -> str:
    """The text of a scenario file, as YAML: that of a JSON file is translated."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ScenarioError(f"{path}: over {_MOST_BYTES} bytes: expected a scenario file")
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path}: byte {error.start}: expected UTF-8 text") from None
    except OSError as error:
        raise ScenarioError(
            f"{path}: {error.strerror or error}: expected a readable file"
        ) from None
    return dump(parse_json(text, str(path))) if path.suffix == ".json" else text


def merged(base: Tree, own: Tree) -> Tree:
    """`own` over `base`: mappings key by key, everything else and another kind of trajectory whole, null removes."""
    result = dict(base)
    for key, value in own.items():
        below = result.get(key)
        if value is None:
            result.pop(key, None)
        elif isinstance(value, dict) and isinstance(below, dict):
            kind = below.get("kind")
            other = key == "trajectory" and value.get("kind", kind) != kind  # has other keys
            result[key] = merged({} if other else below, value)
        else:
            result[key] = value
    return result


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
        if not key.isdecimal() or int(key) >= len(node):
            raise ScenarioError(
                f"{source}: override {path}: {key}: expected an index below {len(node)}"
            )
        return int(key)
    if not isinstance(node, dict):
        raise ScenarioError(f"{source}: override {path}: {key}: there is nothing below this key")
    return int(key) if key.isdecimal() and key not in node else key


def overridden(tree: Tree, overrides: Mapping[str, Any], source: str) -> Tree:
    """`tree` with dotted keys (`gains.profile`, `uavs[2].position_m`) set; a None is left out."""
    return with_keys(deepcopy(_loaded(dump(tree))), overrides, source)


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


def set_keys(settings: Iterable[str]) -> dict[str, Any]:
    """The dotted keys of `--set KEY=VALUE`; values are read like the file, so that "5 s" means the same."""
    given = {}
    for text in settings:
        key, found, value = text.partition("=")
        key = key.strip()
        if not found or not key:
            raise ScenarioError(f'--set "{text}": expected KEY=VALUE')
        given[key] = parse(f"value: {value}", f"--set {key}")["value"]
    return given


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
    text: str = yaml.dump(
        tree, Dumper=_WithoutAliases, sort_keys=False, allow_unicode=True, width=120
    )
    return text
