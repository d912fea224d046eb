"""Reading a bag message by message, with an error in words for every way a file can be broken."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, NamedTuple

from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from ptnsbc_nodes.bag.errors import BagError
from ptnsbc_nodes.bag.writer import METADATA_RECORD


class _DamagedError(BagError):
    """A BagError that salvage may get around."""


_MAGIC = b"\x89MCAP0\r\n"


class BagTopic(NamedTuple):
    """One topic of a bag."""

    name: str
    type: str  # package/msg/Name
    messages: int


class BagMessage(NamedTuple):
    """One message of a bag."""

    topic: str
    stamp_ns: int  # log time [ns]
    data: bytes  # CDR


@dataclass(frozen=True)
class Bag:
    """A bag that has been opened; nothing of its messages is held in memory."""

    path: Path  # the .mcap file
    topics: Mapping[str, BagTopic]
    attachments: tuple[str, ...]
    metadata: Mapping[str, str]
    start_ns: int
    end_ns: int
    cut: bool  # found without its end (only with `salvage`)
    salvage: bool  # read up to the first damage instead of raising

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[BagMessage]:
        """Messages of `topics` (all by default), in order of log time.

        With `salvage` in the order of the file, up to the first damage.
        """
        wanted = None if topics is None else frozenset(topics)
        unknown = sorted((wanted or frozenset()) - self.topics.keys())
        if unknown:
            known = ", ".join(self.topics)
            raise BagError(f"{self.path}: no topic {', '.join(unknown)}: expected one of {known}")
        return self._salvaged(wanted) if self.salvage else self._indexed(wanted)

    def attachment(self, name: str) -> bytes:
        """The content of the attachment `name`."""
        if name in self.attachments:
            for record in _records(self.path, salvage=self.salvage):
                if isinstance(record, Attachment) and record.name == name:
                    return record.data
        known = ", ".join(self.attachments) or "none"
        raise BagError(f"{self.path}: no attachment {name!r}: expected one of {known}")

    def _indexed(self, wanted: frozenset[str] | None) -> Iterator[BagMessage]:
        with self.path.open("rb") as stream, _in_words(self.path):
            reader = SeekingReader(stream, validate_crcs=True)
            for _, channel, message in reader.iter_messages(topics=wanted):
                yield BagMessage(channel.topic, message.log_time, message.data)

    def _salvaged(self, wanted: frozenset[str] | None) -> Iterator[BagMessage]:
        channels: dict[int, str] = {}
        for record in _records(self.path, salvage=True):
            if isinstance(record, Channel):
                channels[record.id] = record.topic
            elif isinstance(record, Message):
                topic = channels.get(record.channel_id, "")
                if wanted is None or topic in wanted:
                    yield BagMessage(topic, record.log_time, record.data)


def read_bag(path: Path | str, *, salvage: bool = False) -> Bag:
    """Open a bag: its folder, or the .mcap file itself.

    Args:
        path: Folder or file.
        salvage: Accept a bag that lacks its end (a killed recording) or is damaged, and read it
            up to there.

    Raises:
        BagError: The path is missing, is no MCAP file, is cut, is damaged or holds no message.
    """
    file = _mcap_file(Path(path))
    try:
        bag = _from_summary(file)
    except _DamagedError:
        if not salvage:
            raise
        bag = None
    if bag is None:
        bag = _from_records(file)
        if not salvage:
            held = sum(topic.messages for topic in bag.topics.values())
            raise BagError(
                f"{file} is cut, its end is missing (the recording was killed, or still runs): "
                f"{held} messages are readable; open it with salvage to use them"
            )
    if not any(topic.messages for topic in bag.topics.values()):
        raise BagError(f"{file} holds no message: did the recorder run while the UAVs did?")
    return replace(bag, salvage=salvage)


def _mcap_file(path: Path) -> Path:
    if not path.exists():
        part = path.with_name(path.name + ".part")
        hint = f"; {part} exists, a recording that was not completed" if part.exists() else ""
        raise BagError(f"{path}: no such bag{hint}")
    if path.is_file():
        return path
    files = sorted(path.glob("*.mcap"))
    if not files:
        raise BagError(f"{path}: no .mcap file in this folder: expected a rosbag2 folder")
    if len(files) > 1:
        names = ", ".join(file.name for file in files)
        raise BagError(f"{path}: several .mcap files ({names}): name one of them")
    return files[0]


def _check_magic(path: Path, stream: IO[bytes]) -> None:
    start = stream.read(len(_MAGIC))
    if not start:
        raise BagError(f"{path} is empty (0 bytes): the recording never started")
    if start != _MAGIC and not _MAGIC.startswith(start):
        raise BagError(f"{path} is not MCAP: starts with {start.hex(' ')}")


def _from_summary(path: Path) -> Bag | None:
    """The bag according to its summary section, or None where that is missing."""
    with path.open("rb") as stream:
        _check_magic(path, stream)
        size = stream.seek(0, 2)
        stream.seek(max(0, size - len(_MAGIC)))
        if size < 2 * len(_MAGIC) or stream.read() != _MAGIC:
            return None
        stream.seek(0)
        with _in_words(path):
            return _summarised(path, SeekingReader(stream, validate_crcs=True))


def _summarised(path: Path, reader: SeekingReader) -> Bag | None:
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        return None
    found = _Found()
    found.schemas = {schema.id: schema.name for schema in summary.schemas.values()}
    found.channels = dict(summary.channels)
    found.counts = dict(summary.statistics.channel_message_counts)
    found.attachments = [index.name for index in summary.attachment_indexes]
    found.span = (summary.statistics.message_start_time, summary.statistics.message_end_time)
    for record in reader.iter_metadata():
        found.take(record)
    return found.bag(path, cut=False)


def _from_records(path: Path) -> Bag:
    """The bag according to all records that can be read, for a file without summary."""
    found = _Found()
    for record in _records(path, salvage=True):
        found.take(record)
    return found.bag(path, cut=True)


class _Found:
    """What is known of a bag so far."""

    def __init__(self) -> None:
        self.schemas: dict[int, str] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: dict[int, int] = {}
        self.attachments: list[str] = []
        self.metadata: dict[str, str] = {}
        self.span: tuple[int, int] | None = None

    def take(self, record: object) -> None:
        """Add one record of the file."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record.name
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Attachment):
            self.attachments.append(record.name)
        elif isinstance(record, Metadata) and record.name == METADATA_RECORD:
            self.metadata = dict(record.metadata)
        elif isinstance(record, Message):
            self.counts[record.channel_id] = self.counts.get(record.channel_id, 0) + 1
            first, last = self.span or (record.log_time, record.log_time)
            self.span = (min(first, record.log_time), max(last, record.log_time))

    def bag(self, path: Path, *, cut: bool) -> Bag:
        """The bag made of what was found."""
        topics = {
            channel.topic: BagTopic(
                channel.topic,
                self.schemas.get(channel.schema_id, ""),
                self.counts.get(channel.id, 0),
            )
            for channel in self.channels.values()
        }
        start_ns, end_ns = self.span or (0, 0)
        attachments = tuple(self.attachments)
        return Bag(path, topics, attachments, self.metadata, start_ns, end_ns, cut, cut)


def _records(path: Path, *, salvage: bool) -> Iterator[object]:
    """All records in the order of the file; with `salvage` as far as they can be read."""
    with path.open("rb") as stream:
        try:
            with _in_words(path):
                yield from StreamReader(stream, validate_crcs=True).records
        except _DamagedError:
            if not salvage:
                raise


@contextmanager
def _in_words(path: Path) -> Iterator[None]:
    """Turn whatever the MCAP library stumbles over in a damaged file into a BagError."""
    try:
        yield
    except BagError:
        raise
    except Exception as error:
        # Broad on purpose: damaged bytes surface as struct, zstd, CRC, key, value or EOF errors.
        raise _DamagedError(
            f"{path} is damaged ({type(error).__name__}: {error}): "
            "expected intact chunks; copy the file again or open it with salvage"
        ) from error
