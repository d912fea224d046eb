"""Is a bag whole: every chunk by its checksum, and metadata.yaml beside the files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import yaml

from ptnsbc_io.bag import mcapfile
from ptnsbc_io.bag.errors import DamagedError
from ptnsbc_io.bag.reader import Bag

METADATA = "metadata.yaml"


def ailments(bag: Bag) -> list[str]:
    """What is wrong with a bag that can be opened, empty when nothing is; reads all of it."""
    return [*_files(bag), *_beside(bag)]


def _files(bag: Bag) -> Iterator[str]:
    for path, contents in bag.pieces:
        if contents.damage.cut:
            yield f"{path.name}: its end is missing"
            continue
        counted = 0
        try:
            for _ in mcapfile.walked(path, None, lenient=False):
                counted += 1
        except DamagedError:
            yield f"{path.name}: a damaged chunk"
            continue
        told = sum(contents.counts.values())
        if counted != told:
            yield f"{path.name}: {counted} messages, its summary says {told}"


def _beside(bag: Bag) -> Iterator[str]:
    """metadata.yaml against the files; a single .mcap file needs none."""
    path = bag.path.with_name(METADATA)
    if not path.is_file():
        yield f"{METADATA} is missing"
        return
    try:
        told = yaml.safe_load(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        names, messages = told["relative_file_paths"], told["message_count"]
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError):
        yield f"{METADATA} cannot be read"
        return
    files = [Path(file).name for file, _ in bag.pieces]
    held = sum(topic.messages for topic in bag.topics.values())
    if names != files:
        yield f"{METADATA} lists {', '.join(map(str, names))}, there is {', '.join(files)}"
    elif messages != held:
        yield f"{METADATA} says {messages} messages, the files {held}"
