"""Bags of any kind: what wrote them, which topics hold the odometry, and which scenario was flown.

MCAP is read by `ptnsbc_io.bag`. The library rosbags reads sqlite3 and the files that rosbag2 compressed. Both
give the same: topic, log time, CDR.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import Bag, BagError, BagMessage, BagTopic, read_bag
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


class _RosbagsBag(Bag):
    """A bag that rosbags reads; it is opened for every use, so that reading may stop at any message."""

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[BagMessage]:
        wanted = frozenset(self.topics if topics is None else topics)
        with _rosbags(self.path) as reader:
            chosen = [c for c in reader.connections if c.topic in wanted]
            if not chosen:  # rosbags takes an empty list for all topics
                return
            for connection, stamp_ns, data in reader.messages(connections=chosen):
                yield BagMessage(connection.topic, stamp_ns, bytes(data))


@contextmanager
def _rosbags(folder: Path) -> Iterator[Any]:
    from rosbags.rosbag2 import Reader

    try:
        with Reader(folder) as reader:
            yield reader
    except (GeneratorExit, PtnsbcError):
        raise
    except Exception as error:
        # All exceptions: damaged files raise errors of sqlite and YAML, key errors and value errors.
        raise BagError(
            f"{folder} cannot be read ({type(error).__name__}: {error}): expected a folder "
            "that rosbag2 wrote, with its metadata.yaml"
        ) from error


def open_bag(path: Path) -> Bag:
    """Open a bag of any kind; BagError when there is none."""
    folder = path if path.is_dir() else path.parent
    single = path.suffix == ".mcap" and path.is_file()
    if single or not folder.is_dir() or not _needs_rosbags(folder):
        return read_bag(path)
    with _rosbags(folder) as reader:
        found = [c for c in reader.connections if c.msgcount]
        topics = {c.topic: BagTopic(c.topic, c.msgtype, c.msgcount) for c in found}
        span_ns = int(reader.start_time), int(reader.end_time)
    return _RosbagsBag(folder, topics, (), {}, *span_ns, cut=False, salvage=False)


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


def scenario_of(bag: Bag, given: Path | None) -> Scenario:
    """The scenario with which a bag was flown: the given file, else the attached one."""
    if given is not None:
        return load_scenario(given)
    if SCENARIO_ATTACHMENT not in bag.attachments:
        raise BagError(
            f"{bag.path}: no {SCENARIO_ATTACHMENT} attached: name the scenario with --scenario"
        )
    text = bag.attachment(SCENARIO_ATTACHMENT).decode("utf-8", errors="replace")
    source = f"{bag.path.name}:{SCENARIO_ATTACHMENT}"
    return scenario_from_text(text, source=source, complete=True)


def check_types(bag: Bag, names: TopicNames, scenario: Scenario) -> None:
    """Raise BagError when a topic has another type than the expected one."""
    expected = {
        names.odom: "nav_msgs/msg/Odometry",
        names.wrench: "geometry_msgs/msg/WrenchStamped",
        names.estimate: "nav_msgs/msg/Odometry",
    }
    for pattern, wanted in expected.items():
        for uav in scenario.uav_ids:
            topic = bag.topics.get(names.of(pattern, uav))
            if topic is not None and topic.messages and topic.type != wanted:
                raise BagError(f"{bag.path}: {topic.name} is {topic.type}: expected {wanted}")
