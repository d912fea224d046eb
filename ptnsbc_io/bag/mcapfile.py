"""One MCAP file: what it holds according to its summary, or to its records where that is missing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import IO, NamedTuple

from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, ChunkIndex, Metadata, Schema

from ptnsbc_io.bag.chunk import RECORD_HEAD, BagMessage, Entry, chosen, parse_chunk, unpacked
from ptnsbc_io.bag.errors import BagError, DamagedError
from ptnsbc_io.bag.walk import MAGIC, Damage, walk


class Chunk(NamedTuple):
    """Where a chunk is and what it holds: a long bag has thousands, and they are kept while it is read."""

    first_ns: int  # log time
    last_ns: int
    start: int  # of its record in the file
    size: int  # with the head of the record
    channels: frozenset[int]  # one object for all chunks that hold the same; empty: nobody knows


@dataclass
class Contents:
    """What a file holds besides its messages."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)  # messages by channel
    attachments: list[str] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # by name of the record
    span_ns: tuple[int, int] | None = None  # log time; None without messages
    chunks: list[Chunk] = field(default_factory=list)  # empty: read in the order of the file
    damage: Damage = field(default_factory=Damage)

    def take(self, record: object) -> None:
        """Add one record of the file."""
        if isinstance(record, Entry):
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


def contents_of(path: Path) -> Contents | None:
    """What the summary says; None where it is missing, DamagedError where it is nonsense."""
    with in_words(path), path.open("rb") as stream:
        _check_magic(path, stream)
        size = stream.seek(0, 2)
        stream.seek(max(0, size - len(MAGIC)))
        if size < 2 * len(MAGIC) or stream.read() != MAGIC:
            return None
        stream.seek(0)
        return _summarised(SeekingReader(stream, validate_crcs=True, record_size_limit=size))


def contents_found(path: Path) -> Contents:
    """What all readable records say, for a file without summary; its damage is told."""
    found = Contents()
    with in_words(path), path.open("rb") as stream:
        _check_magic(path, stream)
        for record in walk(stream, found.damage):
            found.take(record)
    return found


def indexed(path: Path, contents: Contents, wanted: frozenset[str] | None) -> Iterator[BagMessage]:
    """Messages in order of log time; DamagedError at the first damage."""
    if not _in_order(contents.chunks):
        yield from _by_library(path, wanted)
        return
    names = _names(contents, wanted)
    with path.open("rb") as stream, in_words(path):
        for chunk in contents.chunks:
            if chunk.channels and chunk.channels.isdisjoint(names):
                continue
            stream.seek(chunk.start + RECORD_HEAD.size)
            data = unpacked(parse_chunk(stream.read(chunk.size - RECORD_HEAD.size)))
            yield from chosen(data, names)


def walked(path: Path, wanted: frozenset[str] | None, *, lenient: bool) -> Iterator[BagMessage]:
    """Messages in the order of the file; at damage they go on behind it, or DamagedError."""
    names: dict[int, str] = {}
    damage = Damage()
    with path.open("rb") as stream, in_words(path):
        for record in walk(stream, damage):
            if damage and not lenient:
                break
            if isinstance(record, Channel):
                names[record.id] = record.topic
            elif isinstance(record, Entry):
                topic = names.get(record.channel_id, "")
                if wanted is None or topic in wanted:
                    yield BagMessage(topic, record.log_ns, record.data)
        if damage and not lenient:
            raise ValueError("a chunk or the end of the file")


def attachment(path: Path, name: str, *, lenient: bool) -> bytes | None:
    """The content of an attachment, None when the file has none of that name."""
    with path.open("rb") as stream, in_words(path):
        found: Iterable[object] = walk(stream, Damage())
        if not lenient:
            found = SeekingReader(stream, validate_crcs=True).iter_attachments()
        for record in found:
            if isinstance(record, Attachment) and record.name == name:
                return bytes(record.data)
    return None


def _by_library(path: Path, wanted: frozenset[str] | None) -> Iterator[BagMessage]:
    """For chunks that overlap in time: the library holds open those that do."""
    with path.open("rb") as stream, in_words(path):
        for _, channel, message in SeekingReader(stream, validate_crcs=True).iter_messages(wanted):
            yield BagMessage(channel.topic, message.log_time, message.data)


def _in_order(chunks: list[Chunk]) -> bool:
    return all(a.last_ns <= b.first_ns for a, b in pairwise(chunks))


def _chunks(indexes: Iterable[ChunkIndex]) -> list[Chunk]:
    """In order of log time."""
    known: dict[frozenset[int], frozenset[int]] = {}
    found = []
    for index in indexes:
        channels = frozenset(index.message_index_offsets)
        channels = known.setdefault(channels, channels)
        span = index.message_start_time, index.message_end_time
        found.append(Chunk(*span, index.chunk_start_offset, index.chunk_length, channels))
    return sorted(found, key=lambda chunk: chunk.first_ns)


def _names(contents: Contents, wanted: frozenset[str] | None) -> dict[int, str]:
    """Topic by channel, of the wanted channels."""
    channels = contents.channels.values()
    return {c.id: c.topic for c in channels if wanted is None or c.topic in wanted}


def _check_magic(path: Path, stream: IO[bytes]) -> None:
    start = stream.read(len(MAGIC))
    if not start:
        raise BagError(f"{path} is empty (0 bytes): the recording never started")
    if start != MAGIC and not MAGIC.startswith(start):
        raise BagError(f"{path} is not MCAP: starts with {start.hex(' ')}")


def _summarised(reader: SeekingReader) -> Contents | None:
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        return None
    statistics = summary.statistics
    found = Contents(
        schemas=dict(summary.schemas),
        channels=dict(summary.channels),
        counts=dict(statistics.channel_message_counts),
        attachments=[index.name for index in summary.attachment_indexes],
        chunks=_chunks(summary.chunk_indexes),
    )
    if statistics.message_count:
        found.span_ns = (statistics.message_start_time, statistics.message_end_time)
    for record in reader.iter_metadata():
        found.take(record)
    return found


@contextmanager
def in_words(path: Path) -> Iterator[None]:
    """Turn whatever damaged bytes make the parsers stumble into a DamagedError."""
    try:
        yield
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
