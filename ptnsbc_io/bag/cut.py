"""A part of a bag, and several bags as one: the messages keep their times and bytes."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from ptnsbc_io.bag.errors import BagError
from ptnsbc_io.bag.metadata import TopicDeclaration
from ptnsbc_io.bag.reader import Bag, read_bag
from ptnsbc_io.bag.records import BagMessage
from ptnsbc_io.bag.repair import declaration_of
from ptnsbc_io.bag.writer import BagWriter

_LATCHED = ("transient_local", "durability: 1\n")  # as rosbag2 writes it, by name or by number
_PROGRESS_EVERY = 5000  # messages

Progress = Callable[[int, int], None]


def _nothing(done: int, total: int) -> None:
    """No progress is shown."""


def trim(
    path: Path,
    target: Path,
    begin_ns: int,
    end_ns: int,
    *,
    overwrite: bool = False,
    advance: Progress = _nothing,
) -> int:
    """Write the messages from `begin_ns` to `end_ns` (log time, both included) into a new bag.

    Messages of latched topics from before `begin_ns`, such as epochs, are kept with their times: they hold on.

    Returns:
        The number of messages written.

    Raises:
        BagError: no bag, or no message in this span.
    """
    bag = read_bag(path)
    latched = {name for name, topic in bag.topics.items() if _is_latched(topic.offered_qos)}

    def kept() -> Iterator[BagMessage]:
        for message in bag.messages():
            within = begin_ns <= message.stamp_ns <= end_ns
            if within or (message.topic in latched and message.stamp_ns < begin_ns):
                yield message

    if not any(begin_ns <= message.stamp_ns <= end_ns for message in bag.messages()):
        begin, end, last = ((t - bag.start_ns) * 1e-9 for t in (begin_ns, end_ns, bag.end_ns))
        raise BagError(
            f"{path}: no message from {begin:g} s to {end:g} s after its first one: "
            f"expected times from 0 s to {last:g} s"
        )
    return _write([bag], kept(), target, overwrite=overwrite, advance=advance)


def merge(
    paths: Sequence[Path], target: Path, *, overwrite: bool = False, advance: Progress = _nothing
) -> int:
    """Write the messages of several bags of one flight into a new bag, in the order of their times.

    Returns:
        The number of messages written.

    Raises:
        BagError: a topic or an attachment is in two of the bags, and is not the same; or a bag is given twice.
    """
    bags = [read_bag(path) for path in paths]
    files = [file.resolve() for bag in bags for file, _ in bag.files]
    for file in files:
        if files.count(file) > 1:
            raise BagError(f"{file} is given twice: expected different bags")
    messages = heapq.merge(*(bag.messages() for bag in bags), key=lambda one: one.stamp_ns)
    return _write(bags, messages, target, overwrite=overwrite, advance=advance)


def _is_latched(offered: str) -> bool:
    return any(word in f"{offered}\n" for word in _LATCHED)


def _write(
    bags: Sequence[Bag],
    messages: Iterator[BagMessage],
    target: Path,
    *,
    overwrite: bool,
    advance: Progress,
) -> int:
    """Write the messages; returns how many they were."""
    total = sum(topic.messages for bag in bags for topic in bag.topics.values())
    writer = BagWriter(
        target,
        list(_topics(bags).values()),
        attachments=_attachments(bags),
        metadata=_metadata(bags),
        overwrite=overwrite,
    )
    done = 0
    with writer:
        for done, message in enumerate(messages, start=1):
            writer.write(message.topic, message.stamp_ns, message.data)
            if done % _PROGRESS_EVERY == 0:
                advance(done, total)
    return done


def _topics(bags: Sequence[Bag]) -> Mapping[str, TopicDeclaration]:
    found: dict[str, TopicDeclaration] = {}
    for bag in bags:
        for path, contents in bag.files:
            for channel in contents.channels.values():
                schema = contents.schemas.get(channel.schema_id)
                if schema is None:
                    continue
                own = declaration_of(channel, schema)
                known = found.setdefault(own.name, own)
                if (known.type, known.schema) != (own.type, own.schema):
                    raise BagError(
                        f"{path}: {own.name} is a {own.type}, and a {known.type} in another bag: "
                        "expected one type for a topic"
                    )
    return found


def _attachments(bags: Sequence[Bag]) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    for bag in bags:
        for name in bag.attachments:
            data = bag.attachment(name)
            if found.setdefault(name, data) != data:
                raise BagError(
                    f"{bag.path}: its {name} is not that of the other bag: expected bags of one flight"
                )
    return found


def _metadata(bags: Sequence[Bag]) -> dict[str, str]:
    """The common metadata of all bags; where they differ, the first bag counts."""
    found: dict[str, str] = {}
    for bag in bags:
        for key, value in bag.metadata.items():
            found.setdefault(key, value)
    return found
