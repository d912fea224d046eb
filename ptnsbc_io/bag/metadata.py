"""The metadata of rosbag2 (Jazzy, version 9): quality of service of the topics, and metadata.yaml."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ptnsbc_io.bag.definitions import definition
from ptnsbc_io.bag.errors import BagError

METADATA_FILE = "metadata.yaml"
METADATA_RECORD = "ptnsbc"  # of MCAP, with our own keys and values

_LONGEST_METADATA = 4_000_000  # [bytes]
_DEEPEST = 20
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INFINITE = {"sec": 9223372036, "nsec": 854775807}  # RMW_DURATION_INFINITE
_RELIABILITY = ("reliable", "best_effort")
_DURABILITY = ("volatile", "transient_local")


class TopicInfo(NamedTuple):
    """A topic of a bag and the quality of service that its publisher offers."""

    name: str
    type: str  # package/msg/Name
    reliability: str = "reliable"  # or "best_effort"
    durability: str = "volatile"  # or "transient_local"
    depth: int = 10  # keep last


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


def qos_profiles(topic: TopicInfo) -> list[dict[str, Any]]:
    """`offered_qos_profiles` of version 9; BagError on a policy that ROS does not know."""
    for policy, found, known in (
        ("reliability", topic.reliability, _RELIABILITY),
        ("durability", topic.durability, _DURABILITY),
    ):
        if found not in known:
            raise BagError(f"{topic.name}: {policy}={found!r}: expected {' or '.join(known)}")
    return [
        {
            "history": "keep_last",
            "depth": topic.depth,
            "reliability": topic.reliability,
            "durability": topic.durability,
            "deadline": dict(_INFINITE),
            "lifespan": dict(_INFINITE),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_INFINITE),
            "avoid_ros_namespace_conventions": False,
        }
    ]


def declare(topic: TopicInfo) -> TopicDeclaration:
    """The declaration of a topic; BagError when the definition of its type is not known."""
    text, type_hash = definition(topic.type)
    qos = qos_profiles(topic)
    return TopicDeclaration(topic.name, topic.type, text.encode(), type_hash=type_hash, qos=qos)


def bag_information(
    files: Sequence[FileSummary], topics: Iterable[tuple[TopicDeclaration, int]]
) -> dict[str, Any]:
    """The value of `rosbag2_bagfile_information`.

    Args:
        files: the files of the bag.
        topics: each topic and the number of its messages.
    """
    spans = [(file.start_ns, file.end_ns) for file in files if file.messages]
    start_ns = min((start for start, _ in spans), default=0)
    end_ns = max((end for _, end in spans), default=0)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(file.messages for file in files),
        "topics_with_message_count": [_topic_entry(*topic) for topic in topics],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [_file_entry(file) for file in files],
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


def _file_entry(file: FileSummary) -> dict[str, Any]:
    return {
        "path": file.name,
        "starting_time": {"nanoseconds_since_epoch": file.start_ns},
        "duration": {"nanoseconds": file.end_ns - file.start_ns},
        "message_count": file.messages,
    }


def _topic_entry(topic: TopicDeclaration, messages: int) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type,
            "serialization_format": topic.message_encoding,
            "offered_qos_profiles": [dict(profile) for profile in topic.qos],
            "type_description_hash": topic.type_hash,
        },
        "message_count": messages,
    }


def to_yaml(value: Any, indent: str = "") -> str:
    """Nested dicts, lists and scalars as block YAML.

    Strings are always quoted, so that no reader has to guess a type. The text does not depend on the
    version of a YAML library: equal bags have equal bytes.
    """
    if isinstance(value, dict) and value:
        return "".join(f"{indent}{key}:{_nested(item, indent)}" for key, item in value.items())
    if isinstance(value, list) and value:
        lines = (to_yaml(item, indent + "  ") for item in value)
        return "".join(f"{indent}- {line[len(indent) + 2 :]}" for line in lines)
    return f"{indent}{json.dumps(value)}\n"


def _nested(item: Any, indent: str) -> str:
    if isinstance(item, (dict, list)) and item:
        return "\n" + to_yaml(item, indent + "  ")
    return " " + to_yaml(item)
