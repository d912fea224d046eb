"""Metadata of a bag as rosbag2 (Jazzy, version 9) writes it: definitions of types, quality of service, metadata.yaml.

Definition (ros2msg) and type hash (RIHS01) of a message type come from the share folders of the installed ROS packages.
Where a package is absent (a machine without ROS; tf2_msgs, which has no wheel, where it is not built) they come from
`definitions.json` beside this file, which holds Jazzy's text for the types of this project. The texts of `rosbags`
lack the comments, so bags would change with the machine.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ptnsbc_core.errors import PtnsbcError

_PRIMITIVE = re.compile(r"bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string")
_SEPARATOR = "=" * 80
_TABLE_FILE = Path(__file__).with_name("definitions.json")
METADATA_FILE = "metadata.yaml"
METADATA_RECORD = "ptnsbc"  # of MCAP, with our own keys and values
_LONGEST_METADATA = 4_000_000  # [bytes]
_DEEPEST = 20
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INFINITE = {"sec": 9223372036, "nsec": 854775807}  # RMW_DURATION_INFINITE


class BagError(PtnsbcError):
    """A bag cannot be written or read; the text names the file, the reason and the way out."""


class DamagedError(BagError):
    """A bag is damaged, and salvage or repair can read around the damage."""


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
        for word in _field_types(text):
            field_type = re.sub(r"(\[.*\])|(<=\d+)", "", word)
            if not _PRIMITIVE.fullmatch(field_type):
                owner, _, nested = field_type.rpartition("/")
                queue.append((owner.split("/")[0] or key[0], nested))
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


def _share_file(package: str, filename: str) -> Path | None:
    # The wheels set no AMENT_PREFIX_PATH; their share folder is in the prefix of the environment.
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    for prefix in [*filter(None, prefixes), sys.prefix]:
        path = Path(prefix, "share", package, "msg", filename)
        if path.is_file():
            return path
    return None


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


@cache
def _from_table(package: str, name: str) -> Mapping[str, str]:
    table: dict[str, dict[str, str]] = json.loads(_TABLE_FILE.read_text())
    if (entry := table.get(f"{package}/msg/{name}")) is None:
        raise BagError(
            f"no definition of {package}/msg/{name}: install the ROS package {package}, "
            "or source its workspace so that AMENT_PREFIX_PATH names it"
        )
    return entry


class TopicDeclaration(NamedTuple):
    """A topic with all that a bag holds about it."""

    name: str
    type: str
    schema: bytes  # definition of the type and of its nested types
    schema_encoding: str = "ros2msg"
    message_encoding: str = "cdr"
    type_hash: str = ""
    qos: Sequence[Mapping[str, Any]] = ()  # offered_qos_profiles
    metadata: Mapping[str, str] | None = None  # of the channel; None: made of the two above

    @property
    def channel_metadata(self) -> dict[str, str]:
        """The metadata that rosbag2 writes beside the channel."""
        if self.metadata is not None:
            return dict(self.metadata)
        offered = to_yaml([dict(profile) for profile in self.qos])
        return {"offered_qos_profiles": offered, "topic_type_hash": self.type_hash}


class FileSummary(NamedTuple):
    """A file of a finished bag; its times are zero when it has no message."""

    name: str
    start_ns: int  # first log time
    end_ns: int  # last log time
    messages: int


def declare(
    name: str, kind: str, *, reliable: bool = True, latched: bool = False, depth: int = 10
) -> TopicDeclaration:
    """A topic of type `package/msg/Name`, with the quality of service that its publisher offers, as of version 9.

    BagError when the definition of its type is not known.
    """
    text, type_hash = definition(kind)
    profile = {
        "history": "keep_last",
        "depth": depth,
        "reliability": "reliable" if reliable else "best_effort",
        "durability": "transient_local" if latched else "volatile",
        "deadline": dict(_INFINITE),
        "lifespan": dict(_INFINITE),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_INFINITE),
        "avoid_ros_namespace_conventions": False,
    }
    return TopicDeclaration(name, kind, text.encode(), type_hash=type_hash, qos=[profile])


def bag_information(
    files: Sequence[FileSummary], topics: Iterable[tuple[TopicDeclaration, int]]
) -> dict[str, Any]:
    """The value of `rosbag2_bagfile_information` of a bag's files, and of its topics with their numbers of messages."""
    spans = [(file.start_ns, file.end_ns) for file in files if file.messages]
    start_ns = min((start for start, _ in spans), default=0)
    end_ns = max((end for _, end in spans), default=0)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(file.messages for file in files),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": topic.message_encoding,
                    "offered_qos_profiles": [dict(profile) for profile in topic.qos],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": messages,
            }
            for topic, messages in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.start_ns},
                "duration": {"nanoseconds": file.end_ns - file.start_ns},
                "message_count": file.messages,
            }
            for file in files
        ],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def read_metadata(path: Path) -> dict[str, Any]:
    """`rosbag2_bagfile_information` of a metadata.yaml; BagError when it cannot be read."""
    try:
        if path.stat().st_size > _LONGEST_METADATA:
            raise ValueError(f"longer than {_LONGEST_METADATA} bytes")
        stated = plain_yaml(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        return dict(stated)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BagError(f"{path} cannot be read ({error}): expected what rosbag2 writes") from None


def plain_yaml(text: str) -> Any:
    """The value of a YAML text; ValueError when it is none, nested deeply, or has aliases.

    A few bytes of aliases stand for gigabytes.
    """
    depth = 0
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if isinstance(event, yaml.AliasEvent) or depth > _DEEPEST:
                raise ValueError("aliases, or nested too deeply")
        return yaml.load(text, Loader=_LOADER)
    except yaml.YAMLError as error:
        raise ValueError(f"not YAML: {error}") from None


def offered_profiles(text: str) -> list[dict[str, Any]]:
    """The profiles that a channel states; none when it states anything else than numbers, texts and durations."""
    try:
        profiles = plain_yaml(text)
    except ValueError:
        return []
    if not isinstance(profiles, list) or not all(isinstance(one, dict) for one in profiles):
        return []
    values = [value for profile in profiles for value in profile.values()]
    parts = [part for v in values for part in (v.values() if isinstance(v, dict) else [v])]
    plain = all(isinstance(part, str | int | float) for part in parts)
    plain = plain and all(isinstance(key, str | int | float) for one in profiles for key in one)
    fits = all(abs(part) < 2**64 for part in parts if isinstance(part, int))
    return profiles if plain and fits else []


def is_latched(offered_qos: str) -> bool:
    """True if the first publisher of a topic kept messages for who joins late; rosbag2 writes words, once numbers."""
    first = next(iter(offered_profiles(offered_qos)), {})
    return str(first.get("durability")).lower() in ("transient_local", "1")


def to_yaml(value: Any, indent: str = "") -> str:
    """Nested dicts, lists and scalars as block YAML.

    Strings are always quoted, so that no reader has to guess a type. The text does not depend on the
    version of a YAML library: equal bags have equal bytes.
    """
    if isinstance(value, dict) and value:
        parts = []
        for key, item in value.items():
            block = isinstance(item, dict | list) and item
            parts.append(f"{indent}{key}:" + (" " + to_yaml(item) if not block else "\n"))
            parts.append(to_yaml(item, indent + "  ") if block else "")
        return "".join(parts)
    if isinstance(value, list) and value:
        lines = (to_yaml(item, indent + "  ") for item in value)
        return "".join(f"{indent}- {line[len(indent) + 2 :]}" for line in lines)
    return f"{indent}{json.dumps(value)}\n"
