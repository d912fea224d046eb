"""Bags made of bags: repaired, from all that is readable, or a span.

The new bag is written beside its name and renamed at the end. A damaged bag is kept unless it is to be discarded.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_io.bag import mcap_file
from ptnsbc_io.bag.mcap_file import BagMessage, Damage
from ptnsbc_io.bag.metadata import (
    BagError,
    DamagedError,
    TopicDeclaration,
    is_latched,
    offered_profiles,
)
from ptnsbc_io.bag.reader import Bag, read_bag
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
    wrong_times: int  # log times that no clock shows, mended
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
    bag = read_bag(source, salvage=True)
    writer = _writer(temporary, bag)
    writer.name = target.name
    total = sum(topic.messages for topic in bag.topics.values())
    damage = Damage()
    done = last_ns = 0
    try:
        with writer:
            for message in _rescued(writer, bag, damage):
                writer.write(*message)
                done, last_ns = done + 1, max(last_ns, message.stamp_ns)
                if done % _PROGRESS_EVERY == 0 or done == total:
                    advance(done, total)
        if not done:
            raise BagError(f"{source}: no message can be read: there is nothing to rescue")
        original: Path | None = source if moved is None else source.rename(moved)
        temporary.rename(target)
        if discard and original is not None:
            shutil.rmtree(original) if original.is_dir() else original.unlink()
            original = None
    except BaseException:
        for leftover in temporaries:
            shutil.rmtree(leftover, ignore_errors=True)
        raise
    return Repaired(target, original, done, damage.chunks, damage.times, bag.cut, last_ns)


def _rescued(writer: BagWriter, bag: Bag, damage: Damage) -> Iterator[BagMessage]:
    """Every readable message; each file of the bag is one of the writer's too."""
    for file, contents in bag.files:
        writer.split()
        damage.chunks += contents.damage.chunks
        yield from mcap_file.messages(file, contents, None, damage)


def _writer(folder: Path, bag: Bag, *, overwrite: bool = False) -> BagWriter:
    """A writer with the topics, attachments and metadata of a bag, each as its first file has it."""
    topics: dict[str, TopicDeclaration] = {}
    records: dict[str, Mapping[str, str]] = {}
    for _, contents in bag.files:
        records |= contents.metadata
        for channel in contents.channels.values():
            schema = contents.schemas.get(channel.schema_id)
            if schema is None or channel.topic in topics:
                continue
            if channel.message_encoding != "cdr":
                raise BagError(
                    f"{bag.path}: messages in {channel.message_encoding}: expected cdr (ROS 2)"
                )
            topics[channel.topic] = TopicDeclaration(
                channel.topic,
                schema.name,
                schema.data,
                schema.encoding,
                channel.message_encoding,
                channel.metadata.get("topic_type_hash", ""),
                offered_profiles(channel.metadata.get("offered_qos_profiles", "")),
                dict(channel.metadata),
            )
    attachments = {}
    for name in bag.attachments:
        with suppress(DamagedError):
            attachments[name] = bag.attachment(name)
    writer = BagWriter(folder, list(topics.values()), attachments=attachments, overwrite=overwrite)
    records.pop("rosbag2", None)  # the writer makes a new one
    writer.records.update(records)
    return writer


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
    writer = _writer(target, bag, overwrite=overwrite)
    total = sum(topic.messages for topic in bag.topics.values())
    done = 0
    with writer:
        for done, message in enumerate(kept(), start=1):
            writer.write(*message)
            if done % _PROGRESS_EVERY == 0:
                advance(done, total)
    return done
