"""Bags that are repaired, from all that is readable, and bags that are run again.

A new bag is written beside its name and renamed at the end. A damaged bag is kept unless it is to be discarded.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from ptnsbc_io.bag import (
    Bag,
    BagError,
    BagMessage,
    BagWriter,
    TopicDeclaration,
    mcap_file,
    read_bag,
)
from ptnsbc_io.bag.mcap_file import Damage
from ptnsbc_io.bag.metadata import DamagedError, offered_profiles
from ptnsbc_sim.plugins.loader import PluginError
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import console
from ptnsbc_tools.limits import path_of
from ptnsbc_tools.reading.bag_reader import scenario_of
from ptnsbc_tools.replay import rerun as runs
from ptnsbc_tools.replay.rerun import Rerun

_PROGRESS_EVERY = 5000  # messages
_MOST_JOBS = 4


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
    bag: str | Path,
    output: str | Path | None = None,
    *,
    discard: bool = False,
    progress: bool | None = None,
) -> Repaired:
    """Restore the index and metadata.yaml of a cut or damaged bag, as `ptnsbc bag repair`.

    A killed recording DIR.part becomes DIR. A damaged bag DIR is replaced and kept as DIR.original.

    Args:
        bag: folder of the bag, the .part of a killed recording, or an .mcap file.
        output: folder of the repaired bag; by default as said above.
    """
    path = Path(os.path.abspath(path_of("bag", bag)))
    part = path.with_name(path.name + ".part")
    source = part if not path.exists() and part.exists() else path
    if not source.exists():
        raise BagError(f"{path}: no such bag")
    if output is None:
        name = source.name.removesuffix(".part")
        output = source.with_name(name if source.is_dir() else f"{source.stem}.repaired")
    target = Path(os.path.abspath(path_of("output", output)))
    # Where the source goes when the target takes its name.
    moved = source.with_name(source.name + ".original") if target == source else None
    if (moved or target).exists():
        raise BagError(f"{moved or target} exists: move it away, or choose another output")
    temporary = target.with_name(target.name + ".repairing")
    temporaries = (temporary, temporary.with_name(temporary.name + ".part"))
    for leftover in temporaries:
        if leftover.exists():
            raise BagError(f"{leftover} exists, of a repair that was interrupted: remove it first")
    found = read_bag(source, salvage=True)
    writer = _writer(temporary, found)
    writer.name = target.name
    total = sum(topic.messages for topic in found.topics.values())
    damage = Damage()
    done = last_ns = 0
    try:
        with console.progress("repairing", progress) as advance, writer:
            for message in _rescued(writer, found, damage):
                writer.write(*message)
                done, last_ns = done + 1, max(last_ns, message.stamp_ns)
                if done % _PROGRESS_EVERY == 0 or done == total:
                    advance(done, total)
        if not done:
            raise BagError(f"{source}: no message can be read: there is nothing to rescue")
        original: Path | None = source if moved is None else source.rename(moved)
        temporary.rename(target)
        if discard and original is not None:
            _discard(original, found, target)
            original = None
    except BaseException:
        for leftover in temporaries:
            shutil.rmtree(leftover, ignore_errors=True)
        raise
    return Repaired(target, original, done, damage.chunks, damage.times, damage.cut, last_ns)


def _discard(damaged: Path, bag: Bag, repaired: Path) -> None:
    """Remove a bag; what else lies in its folder, such as the logs of autopilots, goes into the repaired one."""
    if not damaged.is_dir():
        damaged.unlink()
        return
    own = {"metadata.yaml", *(file.name for file, _ in bag.files)}
    for beside in (path for path in damaged.iterdir() if path.name not in own):
        beside.rename(repaired / beside.name)
    shutil.rmtree(damaged)


def _rescued(writer: BagWriter, bag: Bag, damage: Damage) -> Iterator[BagMessage]:
    """Every readable message; each file of the bag is one of the writer's too."""
    for file, contents in bag.files:
        writer.split()
        damage.chunks += contents.damage.chunks
        damage.cut |= contents.damage.cut
        yield from mcap_file.messages(file, contents, None, damage)


def _writer(folder: Path, bag: Bag) -> BagWriter:
    """A writer with the topics, attachments and metadata of a bag, each as its first file has it."""
    if not bag.files:
        raise BagError(
            f"{bag.path}: expected .mcap files, which `ros2 bag convert` makes of others"
        )
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
    writer = BagWriter(folder, list(topics.values()), attachments=attachments)
    records.pop("rosbag2", None)  # the writer makes a new one
    writer.records.update(records)
    return writer


def rerun(
    bag: str | Path,
    *,
    scenario: str | Path | None = None,
    plugins: Sequence[str] = (),
    progress: bool | None = None,
) -> Rerun:
    """Run the recorded inputs of a flight through the controllers again, as `ptnsbc bag replay --rerun`.

    Args:
        scenario: scenario file to use instead of the attached one.
        plugins: FILE.py:NAME to execute, of a bag whose scenario names a law, a task or a controller.

    Returns:
        What was compared, byte for byte; `verdict` is the word, `first` the first difference.

    Raises:
        PluginError: the scenario names a plug-in, and none is given.
        BagError: no bag, or none that can be run again.
    """
    path = path_of("bag", bag)
    found = read_bag(path)
    flown = scenario_of(found, None if scenario is None else path_of("scenario", scenario))
    flown = _trusted(path, flown, plugins)
    with console.compiling():
        from ptnsbc_nodes.runtime.warmup import load_fleet

        load_fleet(flown)
    jobs = min(os.cpu_count() or 1, _MOST_JOBS)
    return runs.rerun(found, flown, progress, jobs)


def _trusted(path: Path, flown: Scenario, plugins: Sequence[str]) -> Scenario:
    """The scenario of a bag with the files of its plug-ins; PluginError when one that it names is not given."""
    given = {plugin.rpartition(":")[2]: plugin for plugin in plugins}
    changes: dict[str, str] = {}
    for key, named in (
        ("law", flown.law),
        ("plugins.task", flown.plugins.task),
        ("plugins.controller", flown.plugins.controller),
    ):
        if named is None or Path(named).is_absolute():
            continue
        name = named.rpartition(":")[2]
        if name not in given:
            raise PluginError(
                f"{path}: flown with the {key.rpartition('.')[2]} {named}, which a bag does not carry: "
                f"give the plugin FILE.py:{name}"
            )
        changes[key] = given[name]
    return flown.with_(changes) if changes else flown
