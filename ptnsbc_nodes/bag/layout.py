"""The rosbag2 side of a bag: quality of service and metadata.yaml, version 9 (Jazzy)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

from ptnsbc_nodes.bag.errors import BagError

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


class TopicCount(NamedTuple):
    """A topic of a finished bag."""

    info: TopicInfo
    type_hash: str
    messages: int


class TimeSpan(NamedTuple):
    """First and last log time [ns]; zeros for a bag without messages."""

    start_ns: int
    end_ns: int


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


def bag_information(filename: str, span: TimeSpan, topics: Sequence[TopicCount]) -> dict[str, Any]:
    """The value of `rosbag2_bagfile_information`."""
    total = sum(topic.messages for topic in topics)
    duration = {"nanoseconds": span.end_ns - span.start_ns}
    start = {"nanoseconds_since_epoch": span.start_ns}
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": duration,
        "starting_time": start,
        "message_count": total,
        "topics_with_message_count": [_topic_entry(topic) for topic in topics],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [filename],
        "files": [
            {
                "path": filename,
                "starting_time": start,
                "duration": duration,
                "message_count": total,
            }
        ],
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


def _topic_entry(topic: TopicCount) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.info.name,
            "type": topic.info.type,
            "serialization_format": "cdr",
            "offered_qos_profiles": qos_profiles(topic.info),
            "type_description_hash": topic.type_hash,
        },
        "message_count": topic.messages,
    }


def _forever() -> dict[str, int]:
    return {"sec": _FOREVER[0], "nsec": _FOREVER[1]}


def _unknown(topic: TopicInfo, what: str, found: str, known: Sequence[str]) -> BagError:
    return BagError(f"{topic.name}: {what}={found!r}: expected {' or '.join(known)}")
