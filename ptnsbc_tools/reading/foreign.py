"""Bags that others recorded: what the verdict needs of them, whatever wrote them.

MCAP is read by our own reader, sqlite3 and what rosbag2 compressed itself by rosbags. Both hand
over the same: topic, log time, CDR.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import yaml

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import BagError, BagMessage, read_bag
from ptnsbc_io.bag.metadata import METADATA_FILE
from ptnsbc_sim.scenario import Scenario

UAV = "{n}"


class TopicPatternError(PtnsbcError):
    """A pattern that names no UAV."""


@dataclass(frozen=True)
class Names:
    """Names of topics; `{n}` stands for the id of the UAV."""

    odom: str = "/uav{n}/odom"
    wrench: str = "/uav{n}/setpoint/wrench"
    estimate: str = "/uav{n}/leader_estimate"
    truth: str = "/uav{n}/truth"

    def __post_init__(self) -> None:
        for option, pattern in vars(self).items():
            if UAV not in pattern:
                raise TopicPatternError(
                    f"--{option} {pattern!r}: expected {UAV} for the id of the UAV, "
                    f"like /drone{UAV}/odom"
                )

    def of(self, pattern: str, uav: int) -> str:
        """The topic of one UAV."""
        return pattern.replace(UAV, str(uav))


class Source(Protocol):
    """A bag of any kind."""

    path: Path

    def types(self) -> Mapping[str, str]:
        """Type of each topic that has messages."""

    def messages(self, topics: Iterable[str]) -> Iterator[BagMessage]:
        """Messages of these topics."""

    def scenario(self) -> str | None:
        """Text of the scenario it carries."""


class _Mcap:
    def __init__(self, path: Path, attachment: str) -> None:
        self._bag = read_bag(path)
        self._attachment = attachment
        self.path = self._bag.path

    def types(self) -> Mapping[str, str]:
        return {topic.name: topic.type for topic in self._bag.topics.values() if topic.messages}

    def messages(self, topics: Iterable[str]) -> Iterator[BagMessage]:
        return self._bag.messages(topics)

    def scenario(self) -> str | None:
        if self._attachment not in self._bag.attachments:
            return None
        return self._bag.attachment(self._attachment).decode("utf-8", errors="replace")


class _Rosbag2:
    """By rosbags; opened anew for every look, so that it can be left at any time."""

    def __init__(self, folder: Path) -> None:
        self.path = folder
        with self._open() as reader:
            self._types = {c.topic: c.msgtype for c in reader.connections if c.msgcount}

    def types(self) -> Mapping[str, str]:
        return self._types

    def messages(self, topics: Iterable[str]) -> Iterator[BagMessage]:
        wanted = frozenset(topics)
        with self._open() as reader:
            chosen = [c for c in reader.connections if c.topic in wanted]
            if not chosen:  # to rosbags that would mean all
                return
            for connection, stamp_ns, data in reader.messages(connections=chosen):
                yield BagMessage(connection.topic, stamp_ns, bytes(data))

    def scenario(self) -> str | None:
        return None

    @contextmanager
    def _open(self) -> Iterator[Any]:
        from rosbags.rosbag2 import Reader

        try:
            with Reader(self.path) as reader:
                yield reader
        except (GeneratorExit, PtnsbcError):
            raise
        except Exception as error:
            # Broad on purpose: damaged files surface as sqlite, YAML, key and value errors.
            raise BagError(
                f"{self.path} cannot be read ({type(error).__name__}: {error}): expected a folder "
                "that rosbag2 wrote, with its metadata.yaml"
            ) from error


def open_source(path: Path, attachment: str) -> Source:
    """A bag of any kind; BagError when it is none."""
    folder = path if path.is_dir() else path.parent
    single = path.suffix == ".mcap" and path.is_file()
    if not single and folder.is_dir() and _needs_rosbags(folder):
        return _Rosbag2(folder)
    return _Mcap(path, attachment)


def _needs_rosbags(folder: Path) -> bool:
    """Whether a folder holds sqlite3, or what rosbag2 compressed itself."""
    if not (folder / METADATA_FILE).is_file():
        return False
    if not any(folder.glob("*.mcap")):
        return True
    try:
        told = yaml.safe_load((folder / METADATA_FILE).read_text(encoding="utf-8"))
        return bool(told["rosbag2_bagfile_information"].get("compression_mode"))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, yaml.YAMLError):
        return False


def check_types(source: Source, names: Names, flown: Scenario) -> None:
    """Refuse topics that hold something else than is read from them."""
    expected = {
        names.odom: "nav_msgs/msg/Odometry",
        names.wrench: "geometry_msgs/msg/WrenchStamped",
    }
    expected[names.estimate] = "nav_msgs/msg/Odometry"
    types = source.types()
    for pattern, wanted in expected.items():
        for uav in flown.uav_ids:
            topic = names.of(pattern, uav)
            if types.get(topic, wanted) != wanted:
                raise BagError(f"{source.path}: {topic} is {types[topic]}: expected {wanted}")
