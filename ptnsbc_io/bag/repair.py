"""Bags made of bags: repaired, from all that is readable, or a span.

The new bag is written beside its name and renamed at the end. A damaged bag is kept unless it is to be discarded.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_io.bag import mcap_file
from ptnsbc_io.bag.mcap_file import BagMessage, Contents, Damage, MessageRecord, walk
from ptnsbc_io.bag.metadata import (
    BagError,
    DamagedError,
    TopicDeclaration,
    is_latched,
    offered_profiles,
)
from ptnsbc_io.bag.reader import mcap_files, read_bag
from ptnsbc_io.bag.writer import BagWriter

_PART = ".part"
_ORIGINAL = ".original"
_REPAIRING = ".repairing"
_PROGRESS_EVERY = 5000  # messages

Progress = Callable[[int, int], None]


class Repaired(NamedTuple):
    """The result of a repair."""

    bag: Path
    original: Path | None  # where the damaged bag is now; None: it was discarded
    messages: int
    damaged_chunks: int  # left out, with all messages in them
    cut: bool  # the end was missing
    last_ns: int  # log time of the newest message [ns]


def repair(
    path: Path,
    target: Path | None = None,
    *,
    discard: bool = False,
    advance: Progress = lambda done, total: None,
) -> Repaired:
    """Repair a bag.

    Args:
        path: folder of a bag, of a recording that was killed (with or without its `.part`), or a file.
        target: where to write it; by default where the recording would have been.
        discard: remove the damaged bag once the repaired one is in place.
        advance: called now and then with the messages done and the messages in all.

    Raises:
        BagError: no message is readable, or a path exists that the repair needs.
    """
    path = Path(os.path.abspath(path))
    part = path.with_name(path.name + _PART)
    source = part if not path.exists() and part.exists() else path
    if not source.exists():
        raise BagError(f"{path}: no such bag")
    if target is None:
        name = source.name.removesuffix(_PART)
        target = source.with_name(name if source.is_dir() else f"{source.stem}.repaired")
    target = Path(os.path.abspath(target))
    # Where the source goes when the target takes its name.
    moved = source.with_name(source.name + _ORIGINAL) if target == source else None
    if (moved or target).exists():
        raise BagError(
            f"{moved or target} exists: move it away, or choose another place with --output"
        )
    temporary = target.with_name(target.name + _REPAIRING)
    temporaries = (temporary, temporary.with_name(temporary.name + _PART))
    for leftover in temporaries:
        if leftover.exists():
            raise BagError(f"{leftover} exists, of a repair that was interrupted: remove it first")
    files = mcap_files(source)
    contents = [_read_contents(file) for file in files]
    total = sum(sum(one.counts.values()) for one in contents)
    if total == 0:
        raise BagError(f"{source}: no message can be read: there is nothing to rescue")
    writer = _writer(temporary, files, contents)
    writer.name = target.name
    damage = Damage()
    done = last_ns = 0
    try:
        with writer:
            for log_ns in _copy(writer, files, contents, damage):
                done, last_ns = done + 1, max(last_ns, log_ns)
                if done % _PROGRESS_EVERY == 0 or done == total:
                    advance(done, total)
        original: Path | None = source if moved is None else source.rename(moved)
        temporary.rename(target)
        if discard and original is not None:
            shutil.rmtree(original) if original.is_dir() else original.unlink()
            original = None
    except BaseException:
        for leftover in temporaries:
            shutil.rmtree(leftover, ignore_errors=True)
        raise
    return Repaired(target, original, total, damage.chunks, damage.cut, last_ns)


def _copy(
    writer: BagWriter, files: list[Path], found: list[Contents], damage: Damage
) -> Iterator[int]:
    """Write every readable message; yields the log time of each."""
    for file, contents in zip(files, found, strict=True):
        writer.split()
        topics = {number: channel.topic for number, channel in contents.channels.items()}
        with mcap_file.open_mcap(file) as stream:
            for record in walk(stream, damage):
                if isinstance(record, MessageRecord) and record.channel_id in topics:
                    topic, log_ns = topics[record.channel_id], record.log_ns
                    writer.write(topic, log_ns, record.data, record.publish_ns, record.sequence)
                    yield log_ns


def _read_contents(file: Path) -> Contents:
    """The contents by the records; the summary completes what a damaged first chunk declared."""
    found = mcap_file.scan_records(file)
    try:
        summary = mcap_file.read_summary(file)
    except DamagedError:
        summary = None
    if summary is not None:
        found.schemas = {**summary.schemas, **found.schemas}
        found.channels = {**summary.channels, **found.channels}
        found.metadata = {**summary.metadata, **found.metadata}
    return found


def _writer(folder: Path, files: list[Path], found: list[Contents]) -> BagWriter:
    topics = _topics(found)
    records: dict[str, Mapping[str, str]] = {}
    for contents in found:
        records |= contents.metadata
    foreign = {topic.message_encoding for topic in topics} - {"cdr"}
    if foreign:
        raise BagError(
            f"{files[0]}: messages in {', '.join(sorted(foreign))}: expected cdr (ROS 2)"
        )
    records.pop("rosbag2", None)  # the writer makes a new one
    attachments = {
        record.name: bytes(record.data) for file in files for record in mcap_file.attachments(file)
    }
    writer = BagWriter(folder, topics, attachments=attachments)
    writer.records.update(records)
    return writer


def _topics(files: Sequence[Contents]) -> list[TopicDeclaration]:
    """The topics of the files of a bag as the first of them declares each, for a writer."""
    found: dict[str, TopicDeclaration] = {}
    for contents in files:
        for channel in contents.channels.values():
            schema = contents.schemas.get(channel.schema_id)
            if schema is None or channel.topic in found:
                continue
            found[channel.topic] = TopicDeclaration(
                channel.topic,
                schema.name,
                schema.data,
                schema.encoding,
                channel.message_encoding,
                channel.metadata.get("topic_type_hash", ""),
                offered_profiles(channel.metadata.get("offered_qos_profiles", "")),
                dict(channel.metadata),
            )
    return list(found.values())


def trim(
    path: Path,
    target: Path,
    begin_s: float = 0.0,
    end_s: float | None = None,
    *,
    overwrite: bool = False,
    advance: Progress = lambda done, total: None,
) -> int:
    """Write the messages of a span into a new bag; returns their number.

    It begins and ends so many seconds after the first message by log time, both included; None: with the last one.

    Messages of latched topics from before the span, such as epochs, are kept with their times: they hold on.

    Raises:
        BagError: no bag, or no message in this span.
    """
    bag = read_bag(path)
    begin_ns = bag.start_ns + nanoseconds(begin_s)
    end_ns = bag.end_ns if end_s is None else bag.start_ns + nanoseconds(end_s)
    latched = {name for name, topic in bag.topics.items() if is_latched(topic.offered_qos)}

    def kept() -> Iterator[BagMessage]:
        for message in bag.messages():
            within = begin_ns <= message.stamp_ns <= end_ns
            if within or (message.topic in latched and message.stamp_ns < begin_ns):
                yield message

    if not any(begin_ns <= message.stamp_ns <= end_ns for message in bag.messages()):
        begin, end, last = (seconds(t - bag.start_ns) for t in (begin_ns, end_ns, bag.end_ns))
        raise BagError(
            f"{path}: no message from {begin:g} s to {end:g} s after its first one: "
            f"expected times from 0 s to {last:g} s"
        )
    writer = BagWriter(
        target,
        _topics([contents for _, contents in bag.files]),
        attachments={name: bag.attachment(name) for name in bag.attachments},
        metadata=bag.metadata,
        overwrite=overwrite,
    )
    total = sum(topic.messages for topic in bag.topics.values())
    done = 0
    with writer:
        for done, message in enumerate(kept(), start=1):
            writer.write(message.topic, message.stamp_ns, message.data)
            if done % _PROGRESS_EVERY == 0:
                advance(done, total)
    return done
