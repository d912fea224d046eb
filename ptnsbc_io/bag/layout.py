"""The rosbag2 side of a bag: quality of service and metadata.yaml, version 9 (Jazzy)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ptnsbc_io.bag.errors import BagError
from ptnsbc_io.bag.msgdef import definition

_FOREVER = (9223372036, 854775807)  # [s], [ns]: RMW_DURATION_INFINITE
_RELIABILITY = ("reliable", "best_effort")
_DURABILITY = ("volatile", "transient_local")


class TopicInfo(NamedTuple):
    """A topic of a bag and the quality of service its publisher offers."""

    name: str
    type: str  # package/msg/Name
    reliability: str = "reliable"  # or "best_effort"
    durability: str = "volatile"  # or "transient_local"
    depth: int = 10  # keep last


class TimeSpan(NamedTuple):
    """First and last log time [ns]; zeros for a bag without messages."""

    start_ns: int
    end_ns: int


class Declared(NamedTuple):
    """A topic with all that a bag says about it."""

    name: str
    type: str
    schema: bytes  # definition of the type, nested ones included
    schema_encoding: str = "ros2msg"
    message_encoding: str = "cdr"
    type_hash: str = ""
    qos: Sequence[Mapping[str, Any]] = ()  # offered_qos_profiles
    metadata: Mapping[str, str] | None = None  # of the channel; None: made of the two above

    @property
    def channel_metadata(self) -> dict[str, str]:
        """What rosbag2 writes beside the channel."""
        if self.metadata is not None:
            return dict(self.metadata)
        offered = to_yaml([dict(profile) for profile in self.qos])
        return {"offered_qos_profiles": offered, "topic_type_hash": self.type_hash}


class TopicCount(NamedTuple):
    """A topic of a finished bag."""

    topic: Declared
    messages: int


class FileCount(NamedTuple):
    """A file of a finished bag."""

    name: str
    span: TimeSpan
    messages: int


def qos_profiles(topic: TopicInfo) -> list[dict[str, Any]]:
    """`offered_qos_profiles` of version 9; BagError on a word ROS does not know."""
    if topic.reliability not in _RELIABILITY:
        raise _unknown(topic, "reliability", topic.reliability, _RELIABILITY)
    if topic.durability not in _DURABILITY:
        raise _unknown(topic, "durability", topic.durability, _DURABILITY)
    return [
        {
            "history": "keep_last",
            "depth": topic.depth,
            "reliability": topic.reliability,
            "durability": topic.durability,
            "deadline": _forever(),
            "lifespan": _forever(),
            "liveliness": "automatic",
            "liveliness_lease_duration": _forever(),
            "avoid_ros_namespace_conventions": False,
        }
    ]


def declared(info: TopicInfo) -> Declared:
    """A topic of an installed type; BagError on one that is not known."""
    text, type_hash = definition(info.type)
    return Declared(
        info.name, info.type, text.encode(), type_hash=type_hash, qos=qos_profiles(info)
    )


def bag_information(files: Sequence[FileCount], topics: Sequence[TopicCount]) -> dict[str, Any]:
    """The value of `rosbag2_bagfile_information`."""
    spans = [file.span for file in files if file.messages]
    span = TimeSpan(
        min((one.start_ns for one in spans), default=0),
        max((one.end_ns for one in spans), default=0),
    )
    return {
        "version": 9,
        "storage_identifier": "mcap",
        **_when(span),
        "message_count": sum(file.messages for file in files),
        "topics_with_message_count": [_topic_entry(topic) for topic in topics],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [_file_entry(file) for file in files],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def to_yaml(value: Any, indent: str = "") -> str:
    """Nested dicts, lists and scalars as block YAML.

    Strings are always quoted, which leaves no room for guesses by the reader, and the text depends
    on no library's version: equal bags have equal bytes.
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


def _when(span: TimeSpan) -> dict[str, Any]:
    return {
        "duration": {"nanoseconds": span.end_ns - span.start_ns},
        "starting_time": {"nanoseconds_since_epoch": span.start_ns},
    }


def _file_entry(file: FileCount) -> dict[str, Any]:
    when = _when(file.span)
    return {
        "path": file.name,
        "starting_time": when["starting_time"],
        "duration": when["duration"],
        "message_count": file.messages,
    }


def _topic_entry(found: TopicCount) -> dict[str, Any]:
    topic = found.topic
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type,
            "serialization_format": topic.message_encoding,
            "offered_qos_profiles": [dict(profile) for profile in topic.qos],
            "type_description_hash": topic.type_hash,
        },
        "message_count": found.messages,
    }


def _forever() -> dict[str, int]:
    return {"sec": _FOREVER[0], "nsec": _FOREVER[1]}


def _unknown(topic: TopicInfo, what: str, found: str, known: Sequence[str]) -> BagError:
    return BagError(f"{topic.name}: {what}={found!r}: expected {' or '.join(known)}")
