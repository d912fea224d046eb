"""Reading a bag message by message, with an error in words for every way a file can be broken."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ptnsbc_io.bag import mcapfile
from ptnsbc_io.bag.chunk import BagMessage
from ptnsbc_io.bag.errors import BagError, DamagedError
from ptnsbc_io.bag.mcapfile import Contents
from ptnsbc_io.bag.writer import METADATA_RECORD

_PIECE = re.compile(r"_(\d+)\.mcap$")


class BagTopic(NamedTuple):
    """One topic of a bag."""

    name: str
    type: str  # package/msg/Name
    messages: int
    offered_qos: str = ""  # YAML of rosbag2, empty when the bag does not say


@dataclass(frozen=True)
class Bag:
    """A bag that has been opened; nothing of its messages is held in memory."""

    path: Path  # the .mcap file, the first one of a bag that was split
    topics: Mapping[str, BagTopic]
    attachments: tuple[str, ...]
    metadata: Mapping[str, str]
    start_ns: int
    end_ns: int
    cut: bool  # found without its end (only with `salvage`)
    salvage: bool  # read around damage instead of raising
    pieces: tuple[tuple[Path, Contents], ...] = ()  # its files, in order

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[BagMessage]:
        """Messages of `topics` (all by default), in order of log time within each file.

        With `salvage` in the order of the file, and without what is damaged.
        """
        wanted = None if topics is None else frozenset(topics)
        unknown = sorted((wanted or frozenset()) - self.topics.keys())
        if unknown:
            known = ", ".join(self.topics)
            raise BagError(f"{self.path}: no topic {', '.join(unknown)}: expected one of {known}")
        return self._messages(wanted)

    def _messages(self, wanted: frozenset[str] | None) -> Iterator[BagMessage]:
        for path, contents in self.pieces:
            if self.salvage or not contents.chunks:
                yield from mcapfile.walked(path, wanted, lenient=self.salvage)
            else:
                yield from mcapfile.indexed(path, contents, wanted)

    def attachment(self, name: str) -> bytes:
        """The content of the attachment `name`."""
        for path, contents in self.pieces:
            if name in contents.attachments:
                data = mcapfile.attachment(path, name, lenient=self.salvage)
                if data is not None:
                    return data
        known = ", ".join(self.attachments) or "none"
        raise BagError(f"{self.path}: no attachment {name!r}: expected one of {known}")


def read_bag(path: Path | str, *, salvage: bool = False) -> Bag:
    """Open a bag: its folder, or an .mcap file itself.

    Args:
        path: Folder or file.
        salvage: Accept a bag that lacks its end (a killed recording) or is damaged, and read
            around that.

    Raises:
        BagError: The path is missing, is no MCAP file, is cut, is damaged or holds no message.
    """
    files = mcap_files(Path(path))
    pieces = tuple((file, _opened(file, salvage=salvage)) for file in files)
    bag = _joined(pieces, salvage=salvage)
    if not any(topic.messages for topic in bag.topics.values()):
        raise BagError(f"{bag.path} holds no message: did the recorder run while the UAVs did?")
    return bag


def mcap_files(path: Path) -> list[Path]:
    """The MCAP files of a bag, in order; BagError when there are none, or of several bags."""
    if not path.exists():
        part = path.with_name(path.name + ".part")
        hint = ""
        if part.exists():
            hint = f"; {part} exists, a recording that was not completed: ptnsbc bag repair {path}"
        raise BagError(f"{path}: no such bag{hint}")
    if path.is_file():
        return [path]
    files = list(path.glob("*.mcap"))
    if not files:
        raise BagError(f"{path}: no .mcap file in this folder: expected a rosbag2 folder")
    if len({_PIECE.sub("", file.name) for file in files}) > 1:
        names = ", ".join(sorted(file.name for file in files))
        raise BagError(f"{path}: several .mcap files ({names}): name one of them")
    return sorted(files, key=_piece_number)


def _piece_number(file: Path) -> int:
    found = _PIECE.search(file.name)
    return int(found[1]) if found else 0


def _opened(file: Path, *, salvage: bool) -> Contents:
    try:
        contents = mcapfile.contents_of(file)
    except DamagedError:
        if not salvage:
            raise
        contents = None
    if contents is not None:
        return contents
    contents = mcapfile.contents_found(file)
    if not salvage and contents.damage.cut:
        held = sum(contents.counts.values())
        raise DamagedError(
            f"{file} is cut, its end is missing (the recording was killed, or still runs): "
            f"{held} messages are readable; rescue them with: ptnsbc bag repair"
        )
    return contents


def _joined(pieces: tuple[tuple[Path, Contents], ...], *, salvage: bool) -> Bag:
    topics: dict[str, BagTopic] = {}
    metadata: dict[str, str] = {}
    spans = []
    for _, contents in pieces:
        metadata.update(contents.metadata.get(METADATA_RECORD, {}))
        spans += [contents.span_ns] if contents.span_ns else []
        for topic in _topics(contents):
            before = topics[topic.name].messages if topic.name in topics else 0
            topics[topic.name] = topic._replace(messages=before + topic.messages)
    return Bag(
        path=pieces[0][0],
        topics=topics,
        attachments=tuple(dict.fromkeys(name for _, c in pieces for name in c.attachments)),
        metadata=metadata,
        start_ns=min((first for first, _ in spans), default=0),
        end_ns=max((last for _, last in spans), default=0),
        cut=any(contents.damage.cut for _, contents in pieces),
        salvage=salvage,
        pieces=pieces,
    )


def _topics(contents: Contents) -> Iterator[BagTopic]:
    for channel in contents.channels.values():
        schema = contents.schemas.get(channel.schema_id)
        yield BagTopic(
            channel.topic,
            schema.name if schema else "",
            contents.counts.get(channel.id, 0),
            channel.metadata.get("offered_qos_profiles", ""),
        )
