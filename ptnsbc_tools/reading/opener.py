"""Opens a bag of any kind: MCAP, sqlite3, or compressed by rosbag2.

MCAP is read by `ptnsbc_io.bag`, all else by the library rosbags. Both give the same: topic, log time, CDR.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import Bag, BagError, BagMessage, BagTopic, read_bag
from ptnsbc_io.bag.metadata import METADATA_FILE, read_metadata


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


def open_bag(path: Path, *, salvage: bool = False) -> Bag:
    """Open a bag of any kind; `salvage` as of `read_bag`. BagError when there is none."""
    folder = path if path.is_dir() else path.parent
    single = path.suffix == ".mcap" and path.is_file()
    if single or not path.exists() or not _needs_rosbags(folder):
        return read_bag(path, salvage=salvage)
    with _rosbags(folder) as reader:
        found = [c for c in reader.connections if c.msgcount]
        topics = {c.topic: BagTopic(c.topic, c.msgtype, c.msgcount, _offered_qos(c)) for c in found}
        span_ns = int(reader.start_time), int(reader.end_time) - 1  # it ends after the last message
    return _RosbagsBag(folder, topics, (), {}, *span_ns, cut=False, salvage=False)


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
