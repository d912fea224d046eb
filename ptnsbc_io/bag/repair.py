"""A bag that lacks its end, its index or its metadata.yaml, made whole again from what is readable.

Everything is written beside and renamed at the end; what was there before is kept unless told otherwise.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.records import Attachment, Channel, Schema

from ptnsbc_io.bag import mcapfile
from ptnsbc_io.bag.chunk import Entry
from ptnsbc_io.bag.errors import BagError, DamagedError
from ptnsbc_io.bag.layout import Declared
from ptnsbc_io.bag.mcapfile import Contents
from ptnsbc_io.bag.reader import mcap_files
from ptnsbc_io.bag.walk import Damage, walk
from ptnsbc_io.bag.writer import BagWriter

PART = ".part"
ORIGINAL = ".original"
_BESIDE = ".repairing"

Advance = Callable[[int, int], None]


class Repaired(NamedTuple):
    """What a repair made."""

    bag: Path
    original: Path | None  # where the damaged bag is now; None: it was discarded
    messages: int
    damaged_chunks: int  # left out, with all messages in them
    cut: bool  # the end was missing
    last_ns: int  # log time of the newest message [ns]


class _FileIndex(NamedTuple):
    source: Path
    target: Path
    moved: Path | None  # where the source goes when the target takes its place


def repair(
    path: Path,
    target: Path | None = None,
    *,
    discard: bool = False,
    advance: Advance = lambda done, total: None,
) -> Repaired:
    """Make a bag whole.

    Args:
        path: folder of a bag, of a recording that was killed (with or without its `.part`), or a file.
        target: where to write it; by default where the recording would have been.
        discard: remove the damaged bag once the repaired one is in place.
        advance: called now and then with messages done and in all.

    Raises:
        BagError: nothing readable, or something is in the way.
    """
    places = _places(path, target)
    files = mcap_files(places.source)
    found = [_contents(file) for file in files]
    total = sum(sum(one.counts.values()) for one in found)
    if total == 0:
        raise BagError(f"{places.source}: no message can be read: there is nothing to rescue")
    beside = places.target.with_name(places.target.name + _BESIDE)
    _refuse_leftover(beside)
    writer = _writer(beside, places.target.name, files, found)
    damage = Damage()
    last_ns = 0
    try:
        with writer:
            for done, last in enumerate(_copied(writer, files, found, damage), start=1):
                last_ns = max(last_ns, last)
                if done % 5000 == 0 or done == total:
                    advance(done, total)
        original = _swap(places, beside, discard=discard)
    except BaseException:
        _remove(beside)
        raise
    return Repaired(places.target, original, total, damage.chunks, damage.cut, last_ns)


def _places(path: Path, target: Path | None) -> _FileIndex:
    path = Path(os.path.abspath(path))
    part = path.with_name(path.name + PART)
    source = part if not path.exists() and part.exists() else path
    if not source.exists():
        raise BagError(f"{path}: no such bag")
    if target is None:
        name = source.name.removesuffix(PART)
        target = source.with_name(name if source.is_dir() else f"{source.stem}.repaired")
    target = Path(os.path.abspath(target))
    moved = None
    if target == source:
        moved = source.with_name(source.name + ORIGINAL)
    for place in [moved] if moved else [target]:
        if place.exists():
            raise BagError(f"{place} exists: move it away, or choose another place with --output")
    return _FileIndex(source, target, moved)


def _refuse_leftover(beside: Path) -> None:
    for place in (beside, beside.with_name(beside.name + PART)):
        if place.exists():
            raise BagError(f"{place} exists, of a repair that was interrupted: remove it first")


def _remove(beside: Path) -> None:
    for place in (beside, beside.with_name(beside.name + PART)):
        shutil.rmtree(place, ignore_errors=True)


def _swap(places: _FileIndex, beside: Path, *, discard: bool) -> Path | None:
    original = places.source
    if places.moved is not None:
        places.source.rename(places.moved)
        original = places.moved
    beside.rename(places.target)
    if not discard:
        return original
    if original.is_dir():
        shutil.rmtree(original)
    else:
        original.unlink()
    return None


def _contents(file: Path) -> Contents:
    """What the records say; what the first chunk would have said may be in the summary too."""
    found = mcapfile.contents_found(file)
    try:
        summary = mcapfile.contents_of(file)
    except DamagedError:
        summary = None
    if summary is not None:
        found.schemas = {**summary.schemas, **found.schemas}
        found.channels = {**summary.channels, **found.channels}
        found.metadata = {**summary.metadata, **found.metadata}
    return found


def _writer(beside: Path, name: str, files: list[Path], found: list[Contents]) -> BagWriter:
    topics: dict[str, Declared] = {}
    records: dict[str, Mapping[str, str]] = {}
    for contents in found:
        records |= contents.metadata
        for channel in contents.channels.values():
            schema = contents.schemas.get(channel.schema_id)
            if schema is not None:
                topics.setdefault(channel.topic, _declared(channel, schema))
    foreign = {topic.message_encoding for topic in topics.values()} - {"cdr"}
    if foreign:
        raise BagError(
            f"{files[0]}: messages in {', '.join(sorted(foreign))}: expected cdr (ROS 2)"
        )
    records.pop("rosbag2", None)  # written anew
    writer = BagWriter(beside, list(topics.values()), attachments=_attachments(files))
    writer.name = name
    writer.records.update(records)
    return writer


def _declared(channel: Channel, schema: Schema) -> Declared:
    return Declared(
        channel.topic,
        schema.name,
        schema.data,
        schema.encoding,
        channel.message_encoding,
        channel.metadata.get("topic_type_hash", ""),
        _qos(channel.metadata.get("offered_qos_profiles", "")),
        dict(channel.metadata),
    )


def _qos(text: str) -> list[dict[str, Any]]:
    try:
        profiles = yaml.safe_load(text)
    except yaml.YAMLError:
        return []
    return profiles if isinstance(profiles, list) else []


def _attachments(files: list[Path]) -> dict[str, bytes]:
    found = {}
    for file in files:
        with mcapfile.in_words(file), file.open("rb") as stream:
            for record in walk(stream, Damage()):
                if isinstance(record, Attachment):
                    found[record.name] = bytes(record.data)
    return found


def _copied(
    writer: BagWriter, files: list[Path], found: list[Contents], damage: Damage
) -> Iterator[int]:
    """Write every readable message; gives the log time of each."""
    for file, contents in zip(files, found, strict=True):
        writer.split()
        own = Damage()
        with mcapfile.in_words(file), file.open("rb") as stream:
            for record in walk(stream, own):
                if isinstance(record, Entry) and record.channel_id in contents.channels:
                    topic = contents.channels[record.channel_id].topic
                    writer.write(
                        topic, record.log_ns, record.data, record.publish_ns, record.sequence
                    )
                    yield record.log_ns
        damage.chunks += own.chunks
        damage.cut = damage.cut or own.cut
