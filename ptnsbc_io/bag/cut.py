"""A part of a bag: the messages keep their times and bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from ptnsbc_io.bag.errors import BagError
from ptnsbc_io.bag.metadata import TopicDeclaration
from ptnsbc_io.bag.reader import read_bag
from ptnsbc_io.bag.records import BagMessage
from ptnsbc_io.bag.repair import declaration_of
from ptnsbc_io.bag.writer import BagWriter

_LATCHED = ("transient_local", "durability: 1\n")  # as rosbag2 writes it, by name or by number
_PROGRESS_EVERY = 5000  # messages

Progress = Callable[[int, int], None]


def trim(
    path: Path,
    target: Path,
    begin_ns: int,
    end_ns: int,
    *,
    overwrite: bool = False,
    advance: Progress = lambda done, total: None,
) -> int:
    """Write the messages from `begin_ns` to `end_ns` (log time, both included) into a new bag.

    Messages of latched topics from before `begin_ns`, such as epochs, are kept with their times: they hold on.

    Returns:
        The number of messages written.

    Raises:
        BagError: no bag, or no message in this span.
    """
    bag = read_bag(path)
    latched = {
        name
        for name, topic in bag.topics.items()
        if any(word in f"{topic.offered_qos}\n" for word in _LATCHED)
    }

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
    topics: dict[str, TopicDeclaration] = {}
    for _, contents in bag.files:
        for channel in contents.channels.values():
            schema = contents.schemas.get(channel.schema_id)
            if schema is not None:
                topics.setdefault(channel.topic, declaration_of(channel, schema))
    writer = BagWriter(
        target,
        list(topics.values()),
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
