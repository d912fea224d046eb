"""The definition (ros2msg) and the type hash (RIHS01) of a message type, as bags carry them.

Both come from the share folders of the installed ROS packages. Where a package is absent (a machine without
ROS; tf2_msgs, which has no wheel, where it is not built) they come from `definitions.json` beside this file,
which holds Jazzy's text for the types of this project. The texts of `rosbags` lack the comments, so bags would
change with the machine.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from ptnsbc_io.bag.errors import BagError

_PRIMITIVE = re.compile(r"bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string")
_SEPARATOR = "=" * 80
_TABLE_FILE = Path(__file__).with_name("definitions.json")


class Definition(NamedTuple):
    """The identity of a message type in a bag."""

    text: str  # ros2msg: the .msg file, then those of all nested types
    type_hash: str  # RIHS01_...


@cache
def definition(type_name: str) -> Definition:
    """The definition of `type_name`, written as in ROS 2: `nav_msgs/msg/Odometry`."""
    package, name = _split(type_name)
    parts: list[str] = []
    seen: set[tuple[str, str]] = set()
    queue = [(package, name)]
    while queue:
        key = queue.pop(0)
        if key in seen:
            continue
        seen.add(key)
        text = _msg_text(*key)
        parts.append(f"{_SEPARATOR}\nMSG: {key[0]}/{key[1]}\n{text}" if parts else text)
        queue.extend(_nested(key[0], text))
    return Definition("\n".join(parts), _type_hash(package, name))


@cache
def has_header(type_name: str) -> bool:
    """True if messages of this type start with a std_msgs/Header, or are a Header or a Clock."""
    if type_name in ("std_msgs/msg/Header", "rosgraph_msgs/msg/Clock"):
        return True
    first = next(_field_types(_msg_text(*_split(type_name))), "")
    return first in ("std_msgs/Header", "Header")


def _split(type_name: str) -> tuple[str, str]:
    parts = type_name.split("/")
    if len(parts) != 3 or parts[1] != "msg":
        raise BagError(f"message type {type_name!r}: expected package/msg/Name")
    return parts[0], parts[2]


def _field_types(text: str) -> Iterator[str]:
    """The first word of every line of a .msg file that is not empty."""
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if words:
            yield words[0]


def _nested(package: str, text: str) -> Iterator[tuple[str, str]]:
    """The message types that the fields in `text` use, as (package, name)."""
    for word in _field_types(text):
        field_type = re.sub(r"(\[.*\])|(<=\d+)", "", word)
        if not _PRIMITIVE.fullmatch(field_type):
            owner, _, name = field_type.rpartition("/")
            yield owner.split("/")[0] or package, name


def _share_file(package: str, filename: str) -> Path | None:
    # The wheels set no AMENT_PREFIX_PATH; their share folder is in the prefix of the environment.
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    for prefix in [*filter(None, prefixes), sys.prefix]:
        path = Path(prefix, "share", package, "msg", filename)
        if path.is_file():
            return path
    return None


@cache
def _table() -> dict[str, dict[str, str]]:
    table: dict[str, dict[str, str]] = json.loads(_TABLE_FILE.read_text())
    return table


def _msg_text(package: str, name: str) -> str:
    path = _share_file(package, f"{name}.msg")
    if path is not None:
        return path.read_text()
    return _from_table(package, name)["msg"]


def _type_hash(package: str, name: str) -> str:
    path = _share_file(package, f"{name}.json")
    if path is None:
        return _from_table(package, name)["hash"]
    wanted = f"{package}/msg/{name}"
    for entry in json.loads(path.read_text())["type_hashes"]:
        if entry["type_name"] == wanted:
            return str(entry["hash_string"])
    raise BagError(f"{path}: no hash of {wanted} inside: reinstall {package}")


def _from_table(package: str, name: str) -> dict[str, str]:
    entry = _table().get(f"{package}/msg/{name}")
    if entry is None:
        raise BagError(
            f"no definition of {package}/msg/{name}: install the ROS package {package}, "
            "or source its workspace so that AMENT_PREFIX_PATH names it"
        )
    return entry
