"""One MCAP file: its contents by its summary, or by its records where the summary is missing."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import IO, NamedTuple, TypeVar

from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, ChunkIndex, Metadata, MetadataIndex, Schema
from mcap.stream_reader import StreamReader

from ptnsbc_io.bag.errors import BagError, DamagedError
from ptnsbc_io.bag.records import (
    LARGEST_CHUNK,
    MAGIC,
    MOST_MESSAGES,
    RECORD_HEAD,
    BagMessage,
    Damage,
    MessageRecord,
    Unpacker,
    chunk_messages,
    walk,
)

_stamp = attrgetter("stamp_ns")
R = TypeVar("R", Attachment, Metadata)


class ChunkLocation(NamedTuple):
    """Place and contents of a chunk; a long bag keeps thousands of these while it is read."""

    first_ns: int  # log time
    last_ns: int
    start: int  # of its record in the file
    size: int  # with the head of the record
    channels: frozenset[int]  # shared between chunks that hold the same; empty: not known


@dataclass
class Contents:
    """The contents of a file besides its messages."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)  # messages by channel
    attachments: list[str] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # by name of the record
    span_ns: tuple[int, int] | None = None  # log time; None without messages
    chunks: list[ChunkLocation] = field(
        default_factory=list
    )  # empty: read in the order of the file
    damage: Damage = field(default_factory=Damage)

    def add(self, record: object) -> None:
        """Add one record of the file."""
        if isinstance(record, MessageRecord):
            self.counts[record.channel_id] = self.counts.get(record.channel_id, 0) + 1
            first, last = self.span_ns or (record.log_ns, record.log_ns)
            self.span_ns = (min(first, record.log_ns), max(last, record.log_ns))
        elif isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Attachment):
            self.attachments.append(record.name)
        elif isinstance(record, Metadata):
            self.metadata[record.name] = dict(record.metadata)


@contextmanager
def open_mcap(path: Path) -> Iterator[IO[bytes]]:
    """Open a file for reading; whatever error damaged bytes cause becomes a DamagedError."""
    if not path.is_file():  # a pipe would be waited for
        raise BagError(f"{path} cannot be read: expected a file")
    try:
        with path.open("rb") as stream:
            yield stream
    except (BagError, GeneratorExit):
        raise
    except OSError as error:
        raise BagError(f"{path} cannot be read: {error.strerror or error}") from error
    except Exception as error:
        # Broad on purpose: damaged bytes surface as struct, zstd, CRC, key, value or EOF errors.
        raise DamagedError(
            f"{path} is damaged ({type(error).__name__}: {error}): expected intact chunks; "
            "copy the file again, or rescue what is left with: ptnsbc bag repair"
        ) from error


def read_summary(path: Path) -> Contents | None:
    """The contents by the summary; None when it is missing, DamagedError when it is not valid."""
    with open_mcap(path) as stream:
        _check_magic(path, stream)
        size = stream.seek(0, 2)
        stream.seek(max(0, size - len(MAGIC)))
        if size < 2 * len(MAGIC) or stream.read() != MAGIC:
            return None
        stream.seek(0)
        reader = SeekingReader(stream, validate_crcs=True, record_size_limit=size)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            return None
        statistics = summary.statistics
        found = Contents(
            schemas=dict(summary.schemas),
            channels=dict(summary.channels),
            counts=dict(statistics.channel_message_counts),
            attachments=[index.name for index in summary.attachment_indexes],
            chunks=_chunk_locations(summary.chunk_indexes),
        )
        if statistics.message_count:
            found.span_ns = (statistics.message_start_time, statistics.message_end_time)
        for record in _metadata(stream, summary.metadata_indexes, size):
            found.add(record)
        return found


def scan_records(path: Path) -> Contents:
    """The contents by all readable records, for a file without summary; with its damage."""
    found = Contents()
    with open_mcap(path) as stream:
        _check_magic(path, stream)
        for record in walk(stream, found.damage):
            found.add(record)
    return found


def messages_by_time(
    path: Path, contents: Contents, wanted: frozenset[str] | None
) -> Iterator[BagMessage]:
    """Messages in order of log time; DamagedError at the first damage."""
    channels = contents.channels.values()
    topics = {c.id: c.topic for c in channels if wanted is None or c.topic in wanted}
    chunks = [c for c in contents.chunks if not c.channels or not c.channels.isdisjoint(topics)]
    with open_mcap(path) as stream:
        unpacker = Unpacker(stream.seek(0, 2))

        def messages(chunk: ChunkLocation) -> list[BagMessage]:
            stream.seek(chunk.start + RECORD_HEAD.size)
            found = chunk_messages(unpacker.unpack(stream.read(chunk.size)), topics)
            unpacker.count(len(found))
            return found

        if not any(a.last_ns > b.first_ns for a, b in pairwise(chunks)):
            for chunk in chunks:
                yield from messages(chunk)
            return
        # Chunks overlap in time: those that do are held open.
        open_: list[BagMessage] = []
        for chunk in chunks:
            ready = bisect_left(open_, chunk.first_ns, key=_stamp)
            yield from open_[:ready]
            open_ = sorted(open_[ready:] + messages(chunk), key=_stamp)
            if len(open_) > MOST_MESSAGES or sum(len(one.data) for one in open_) > LARGEST_CHUNK:
                raise ValueError("too many chunks at the same time")
        yield from open_


def messages_in_file_order(
    path: Path, wanted: frozenset[str] | None, *, salvage: bool
) -> Iterator[BagMessage]:
    """Messages in the order of the file; at damage DamagedError, with `salvage` the next chunk."""
    topics: dict[int, str] = {}
    damage = Damage()
    with open_mcap(path) as stream:
        for record in walk(stream, damage):
            if damage and not salvage:
                break
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, MessageRecord):
                topic = topics.get(record.channel_id, "")
                if wanted is None or topic in wanted:
                    yield BagMessage(topic, record.log_ns, record.data)
        if damage and not salvage:
            raise ValueError("a chunk or the end of the file")


def attachments(path: Path) -> Iterator[Attachment]:
    """The attachments of a file that can be read, in the order of the file."""
    with open_mcap(path) as stream:
        for record in walk(stream, Damage()):
            if isinstance(record, Attachment):
                yield record


def attachment(path: Path, name: str) -> Attachment | None:
    """An attachment by the summary; DamagedError when it is damaged."""
    with open_mcap(path) as stream:
        size = stream.seek(0, 2)
        stream.seek(0)
        summary = SeekingReader(stream, record_size_limit=size).get_summary()
        offsets = (
            [one.offset for one in summary.attachment_indexes if one.name == name]
            if summary
            else []
        )
        return _record_at(stream, offsets[0], Attachment, size) if offsets else None


def _record_at(stream: IO[bytes], offset: int, kind: type[R], longest: int) -> R:
    stream.seek(offset)
    records = StreamReader(stream, skip_magic=True, record_size_limit=longest).records
    record = next(records)
    if not isinstance(record, kind):
        raise ValueError(f"{type(record).__name__}: expected {kind.__name__}")
    return record


def _metadata(stream: IO[bytes], indexes: Iterable[MetadataIndex], size: int) -> Iterator[Metadata]:
    """The metadata records of a summary; together they cannot be longer than the file."""
    for index in indexes:
        size -= index.length
        if size < 0:
            raise ValueError("metadata longer than the file")
        yield _record_at(stream, index.offset, Metadata, index.length)


def _check_magic(path: Path, stream: IO[bytes]) -> None:
    start = stream.read(len(MAGIC))
    if not start:
        raise BagError(f"{path} is empty (0 bytes): the recording never started")
    if start != MAGIC and not MAGIC.startswith(start):
        raise BagError(f"{path} is not MCAP: starts with {start.hex(' ')}")


def _chunk_locations(indexes: Iterable[ChunkIndex]) -> list[ChunkLocation]:
    """In order of log time; each chunk once."""
    known: dict[frozenset[int], frozenset[int]] = {}
    found = []
    for index in {index.chunk_start_offset: index for index in indexes}.values():
        channels = frozenset(index.message_index_offsets)
        channels = known.setdefault(channels, channels)
        span = index.message_start_time, index.message_end_time
        found.append(ChunkLocation(*span, index.chunk_start_offset, index.chunk_length, channels))
    return sorted(found, key=lambda chunk: chunk.first_ns)
