"""Reading a bag message by message, with a plain message for every way in which a file can be broken."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io import wire
from ptnsbc_io.bag import mcap_file
from ptnsbc_io.bag.mcap_file import BagMessage, Contents, Damage
from ptnsbc_io.bag.metadata import (
    METADATA_FILE,
    METADATA_RECORD,
    BagError,
    DamagedError,
    read_metadata,
)

_DECODERS: Mapping[str, Callable[[bytes], object]] = {
    "diagnostic_msgs/msg/DiagnosticArray": wire.decode_diagnostics,
    "geometry_msgs/msg/TwistStamped": wire.decode_velocity,
    "geometry_msgs/msg/WrenchStamped": wire.decode_wrench,
    "nav_msgs/msg/Odometry": wire.decode_odometry,
    "std_msgs/msg/Header": wire.decode_header,
}
_FILE_NUMBER = re.compile(r"_(\d+)\.mcap$")


class BagTopic(NamedTuple):
    """One topic of a bag."""

    name: str
    type: str  # package/msg/Name
    messages: int
    offered_qos: str = ""  # YAML of rosbag2, empty when the bag does not say


@dataclass(frozen=True)
class Bag:
    """An open bag; its messages are not held in memory."""

    path: Path  # the .mcap file, the first one of a bag that was split
    topics: Mapping[str, BagTopic]
    attachments: tuple[str, ...]
    metadata: Mapping[str, str]
    start_ns: int
    end_ns: int
    salvage: bool  # read around damage instead of raising
    files: tuple[tuple[Path, Contents], ...] = ()  # in order

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[BagMessage]:
        """Messages of `topics` (all by default), in order of log time within each file.

        With `salvage` what is damaged is left out.
        """
        wanted = None if topics is None else frozenset(topics)
        unknown = sorted((wanted or frozenset()) - self.topics.keys())
        if unknown:
            known = ", ".join(self.topics)
            raise BagError(f"{self.path}: no topic {', '.join(unknown)}: expected one of {known}")

        return chain.from_iterable(
            mcap_file.messages(*file, wanted, Damage() if self.salvage else None)
            for file in self.files
        )

    def attachment(self, name: str) -> bytes:
        """The content of the attachment `name`."""
        for path, contents in self.files:
            if name in contents.attachments:
                return mcap_file.read_attachment(path, contents, name)
        known = ", ".join(self.attachments) or "none"
        raise BagError(f"{self.path}: no attachment {name!r}: expected one of {known}")


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


def read_bag(path: Path | str, *, salvage: bool = False) -> Bag:
    """Open a bag of any kind, its folder or one of its files: MCAP is read here, all else by the library rosbags.

    With `salvage` it may lack its end (a killed recording) or be damaged, and is read around that.

    Raises:
        BagError: The path is missing, is no MCAP file, is cut, is damaged or holds no message.
    """
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    single = path.suffix == ".mcap" and path.is_file()
    if path.exists() and not single and _needs_rosbags(folder):
        return _rosbags_bag(folder)
    files = tuple((file, _read_contents(file, salvage)) for file in mcap_files(path))
    topics: dict[str, BagTopic] = {}
    metadata: dict[str, str] = {}
    counts = sum((contents.counts for _, contents in files), Counter[str]())
    for _, contents in files:
        metadata.update(contents.metadata.get(METADATA_RECORD, {}))
        for channel in contents.channels.values():
            name, schema = channel.topic, contents.schemas.get(channel.schema_id)
            offered = channel.metadata.get("offered_qos_profiles", "")
            topics[name] = BagTopic(name, schema.name if schema else "", counts[name], offered)
    chunks = [chunk for _, contents in files for chunk in contents.chunks]
    if not any(topic.messages for topic in topics.values()):
        raise BagError(f"{files[0][0]} holds no message: did the recorder run while the UAVs did?")
    return Bag(
        path=files[0][0],
        topics=topics,
        attachments=tuple(dict.fromkeys(name for _, c in files for name in c.attachments)),
        metadata=metadata,
        start_ns=min((chunk.first_ns for chunk in chunks), default=0),
        end_ns=max((chunk.last_ns for chunk in chunks), default=0),
        salvage=salvage,
        files=files,
    )


def _rosbags_bag(folder: Path) -> Bag:
    with _rosbags(folder) as reader:
        found = [c for c in reader.connections if c.msgcount]
        topics = {c.topic: BagTopic(c.topic, c.msgtype, c.msgcount, _offered_qos(c)) for c in found}
        span_ns = int(reader.start_time), int(reader.end_time) - 1  # it ends after the last message
    return _RosbagsBag(folder, topics, (), {}, *span_ns, salvage=False)


def _offered_qos(connection: Any) -> str:
    """The QoS profiles of a topic as rosbag2 writes them, with its numbers; JSON is YAML."""
    return json.dumps(
        [
            {
                "reliability": profile.reliability.value,
                "durability": profile.durability.value,
                "depth": profile.depth,
            }
            for profile in connection.ext.offered_qos_profiles
        ]
    )


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


def mcap_files(path: Path) -> list[Path]:
    """The MCAP files of a bag, in order; BagError when there are none, or those of several bags."""
    if not path.exists():
        part = path.with_name(path.name + ".part")
        hint = ""
        if part.exists():
            hint = f"; {part} exists, a recording that was not completed: ptnsbc bag repair {path}"
        raise BagError(f"{path}: no such bag{hint}")
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise BagError(f"{path}: a pipe or a device: expected a file, or the folder of a bag")
    files = list(path.glob("*.mcap"))
    if not files:
        raise BagError(
            f"{path}: no .mcap file in this folder: expected a bag of them, which `ros2 bag convert` makes of others"
        )
    if len({_FILE_NUMBER.sub("", file.name) for file in files}) > 1:
        names = ", ".join(sorted(file.name for file in files))
        raise BagError(f"{path}: several .mcap files ({names}): name one of them")
    numbers = {file: _FILE_NUMBER.search(file.name) for file in files}
    return sorted(files, key=lambda file: int(number[1]) if (number := numbers[file]) else 0)


def _read_contents(file: Path, salvage: bool) -> Contents:
    try:
        contents = mcap_file.read_summary(file)
    except DamagedError:
        if not salvage:
            raise
        contents = None
    contents = contents or mcap_file.scan_records(file)
    damage = contents.damage
    if not salvage and damage.cut:
        held = sum(contents.counts.values())
        raise DamagedError(
            f"{file} is cut, its end is missing (the recording was killed, or still runs): "
            f"{held} messages are readable; rescue them with: ptnsbc bag repair"
        )
    if not salvage and damage:
        raise mcap_file.damaged(file, "a chunk" if damage.chunks else "times of messages")
    return contents


def _is_readable(message: BagMessage, topics: Mapping[str, BagTopic]) -> bool:
    """Whether a message decodes, of the types that verdicts and re-runs read."""
    try:
        _DECODERS.get(topics[message.topic].type, bytes)(message.data)
    except wire.WireError:
        return False
    return True


def find_problems(bag: Bag) -> list[str]:
    """Problems of an open bag, none when it is whole; reads all of it with its checksums."""
    problems = []
    for path, contents in bag.files:
        damage = replace(contents.damage)
        held, unreadable = 0, Counter[str]()
        for message in mcap_file.messages(path, contents, None, damage):
            held += 1
            unreadable[message.topic] += not _is_readable(message, bag.topics)
        summarised = sum(contents.counts.values())
        if damage.cut:
            problems.append(f"{path.name}: its end is missing")
        elif damage.chunks:
            problems.append(f"{path.name}: a damaged chunk")
        elif held != summarised:
            problems.append(f"{path.name}: {held} messages, its summary says {summarised}")
        if damage.times:
            problems.append(f"{path.name}: a time that no clock shows")
        found = ((topic, number) for topic, number in unreadable.items() if number)
        problems += [f"{path.name}: {number} damaged on {topic}" for topic, number in found]
    path = bag.path.with_name(METADATA_FILE)
    if not path.is_file():
        return [*problems, f"{METADATA_FILE} is missing"]
    try:
        stated = read_metadata(path)
        names, messages = stated["relative_file_paths"], stated["message_count"]
        if not all(isinstance(name, str) for name in names) or not 0 <= messages < 2**64:
            raise ValueError("names or a number")
    except (BagError, KeyError, TypeError, ValueError):
        return [*problems, f"{METADATA_FILE} cannot be read"]
    files = [file.name for file, _ in bag.files]
    held = sum(topic.messages for topic in bag.topics.values())
    if names != files:
        problems.append(f"{METADATA_FILE} lists {', '.join(names)}, there is {', '.join(files)}")
    elif messages != held:
        problems.append(f"{METADATA_FILE} says {messages} messages, the files hold {held}")
    return problems
