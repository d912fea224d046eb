"""Bags of any kind: what wrote them, which topics hold the odometry, and which scenario was flown.

MCAP is read by `ptnsbc_io.bag`. The library rosbags reads sqlite3 and the files that rosbag2 compressed. Both
give the same: topic, log time, CDR.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import Bag, BagError, BagMessage, read_bag
from ptnsbc_io.bag.metadata import METADATA_FILE, read_metadata
from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text

SCENARIO_ATTACHMENT = "scenario.yaml"
_UAV = "{n}"


class TopicPatternError(PtnsbcError):
    """A pattern without the id of the UAV."""


@dataclass(frozen=True)
class TopicNames:
    """Names of topics; `{n}` stands for the id of the UAV."""

    odom: str = "/uav{n}/odom"
    wrench: str = "/uav{n}/setpoint/wrench"
    estimate: str = "/uav{n}/leader_estimate"
    truth: str = "/uav{n}/truth"

    def __post_init__(self) -> None:
        for option, pattern in vars(self).items():
            if _UAV not in pattern:
                raise TopicPatternError(
                    f"--{option} {pattern!r}: expected {_UAV} for the id of the UAV, "
                    f"like /drone{_UAV}/odom"
                )

    @staticmethod
    def of(pattern: str, uav: int) -> str:
        """The topic of one UAV."""
        return pattern.replace(_UAV, str(uav))


OUR_TOPICS = TopicNames()


class BagSource(Protocol):
    """A bag of any kind."""

    path: Path

    def types(self) -> Mapping[str, str]:
        """Type of each topic that has messages."""

    def messages(self, topics: Iterable[str]) -> Iterator[BagMessage]:
        """Messages of these topics."""

    def scenario_text(self) -> str | None:
        """The text of the attached scenario, None without one."""


class McapSource:
    """A bag that `ptnsbc_io.bag` reads."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self.path = bag.path

    def types(self) -> Mapping[str, str]:
        """Type of each topic that has messages."""
        return {topic.name: topic.type for topic in self._bag.topics.values() if topic.messages}

    def messages(self, topics: Iterable[str]) -> Iterator[BagMessage]:
        """Messages of these topics."""
        return self._bag.messages(topics)

    def scenario_text(self) -> str | None:
        """The text of the attached scenario, None without one."""
        if SCENARIO_ATTACHMENT not in self._bag.attachments:
            return None
        return self._bag.attachment(SCENARIO_ATTACHMENT).decode("utf-8", errors="replace")


class _RosbagsSource:
    """A bag that rosbags reads; it is opened for every use, so that reading may stop at any message."""

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
            if not chosen:  # rosbags takes an empty list for all topics
                return
            for connection, stamp_ns, data in reader.messages(connections=chosen):
                yield BagMessage(connection.topic, stamp_ns, bytes(data))

    def scenario_text(self) -> str | None:
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
            # All exceptions: damaged files raise errors of sqlite and YAML, key errors and value errors.
            raise BagError(
                f"{self.path} cannot be read ({type(error).__name__}: {error}): expected a folder "
                "that rosbag2 wrote, with its metadata.yaml"
            ) from error


def open_source(path: Path) -> BagSource:
    """Open a bag of any kind; BagError when there is none."""
    folder = path if path.is_dir() else path.parent
    single = path.suffix == ".mcap" and path.is_file()
    if not single and folder.is_dir() and _needs_rosbags(folder):
        return _RosbagsSource(folder)
    return McapSource(read_bag(path))


def _needs_rosbags(folder: Path) -> bool:
    """True if a folder holds sqlite3 files, or files that rosbag2 compressed."""
    if not (folder / METADATA_FILE).is_file():
        return False
    if not any(folder.glob("*.mcap")):
        return True
    try:
        return bool(read_metadata(folder / METADATA_FILE).get("compression_mode"))
    except BagError:
        return False


def scenario_of(source: BagSource, given: Path | None) -> Scenario:
    """The scenario with which a bag was flown: the given file, else the attached one."""
    if given is not None:
        return load_scenario(given)
    text = source.scenario_text()
    if text is None:
        raise BagError(
            f"{source.path}: no {SCENARIO_ATTACHMENT} attached: name the scenario with --scenario"
        )
    return scenario_from_text(
        text, source=f"{source.path.name}:{SCENARIO_ATTACHMENT}", complete=True
    )


def check_types(source: BagSource, names: TopicNames, scenario: Scenario) -> None:
    """Raise BagError when a topic has another type than the expected one."""
    expected = {
        names.odom: "nav_msgs/msg/Odometry",
        names.wrench: "geometry_msgs/msg/WrenchStamped",
        names.estimate: "nav_msgs/msg/Odometry",
    }
    types = source.types()
    for pattern, wanted in expected.items():
        for uav in scenario.uav_ids:
            topic = names.of(pattern, uav)
            if types.get(topic, wanted) != wanted:
                raise BagError(f"{source.path}: {topic} is {types[topic]}: expected {wanted}")
