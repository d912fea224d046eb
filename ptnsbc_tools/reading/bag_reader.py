"""A bag as a Recording: the only place where the verdict meets messages."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.bag import Bag, BagError, BagMessage
from ptnsbc_io.wire import Stamped, WireError, decode_header, decode_odometry, decode_wrench
from ptnsbc_nodes.comm import topics
from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text
from ptnsbc_tools.reading.diagnostics import Diagnostics, DiagnosticStatus, decode_diagnostics
from ptnsbc_tools.reading.disk_track import DiskTrack, Writer
from ptnsbc_tools.reading.foreign import Names, Source, check_types, open_source
from ptnsbc_tools.verdict import Recording, Track
from ptnsbc_tools.verdict.recording import COUNTERS, FORMATION

SCENARIO_ATTACHMENT = "scenario.yaml"
OURS = Names()

_PLANNER = re.compile(r"uav(\d+): planner")
_LINK = re.compile(r"bridge(\d+): link")
_SIM = "sim: world"
_LATENCY = re.compile(r"latency_(\w+)_ms")


def scenario_of(bag: Bag, given: Path | None) -> Scenario:
    """The scenario a bag was flown with: its attachment, or the file given instead."""
    if given is not None:
        return load_scenario(given)
    if SCENARIO_ATTACHMENT not in bag.attachments:
        raise BagError(
            f"{bag.path}: no {SCENARIO_ATTACHMENT} attached: name the scenario with --scenario"
        )
    text = bag.attachment(SCENARIO_ATTACHMENT).decode("utf-8", errors="replace")
    return scenario_from_text(text, source=f"{bag.path.name}:{SCENARIO_ATTACHMENT}")


def _scenario(source: Source, given: Path | None) -> Scenario:
    if given is not None:
        return load_scenario(given)
    text = source.scenario()
    if text is None:
        raise BagError(
            f"{source.path}: no {SCENARIO_ATTACHMENT} attached: name the scenario with --scenario"
        )
    return scenario_from_text(text, source=f"{source.path.name}:{SCENARIO_ATTACHMENT}")


class DiagnosticCounters:
    """What nodes count on /diagnostics."""

    def __init__(self, spool: DiskTrack) -> None:
        self.latency: dict[str, float] = {}  # the newest figures
        self._spool = spool
        self._counters: dict[int, Writer] = {}
        self._sent: dict[int, Writer] = {}

    def take(self, told: Diagnostics) -> None:
        """Take an array of diagnostics."""
        for status in told.statuses:
            if planner := _PLANNER.fullmatch(status.name):
                values = np.array([_number(status.values, key) for key in COUNTERS])
                self._count(self._counters, int(planner[1]), told.stamp_ns, values)
            elif link := _LINK.fullmatch(status.name):
                stamp, _, count = status.values.get("states_sent", "").partition(" ")
                if stamp.isdecimal() and count.isdecimal() and int(count):
                    self._count(self._sent, int(link[1]), int(stamp), np.array([float(count)]))
            elif status.name == _SIM:
                self.latency = _latency(status)

    def _count(self, of: dict[int, Writer], uav: int, stamp_ns: int, values: Array) -> None:
        if stamp_ns >= 0:
            if uav not in of:
                of[uav] = Writer(self._spool)
            of[uav].add(stamp_ns, stamp_ns, values)

    def counters(self) -> dict[int, Track]:
        """What each UAV counted, by `COUNTERS`."""
        return {uav: written.track() for uav, written in self._counters.items()}

    def sent(self) -> dict[int, Track]:
        """Odometry messages that each bridge had sent (T, 1), at the stamp of the newest of them."""
        return {uav: written.track() for uav, written in self._sent.items()}


class _Collector:
    """Messages of a bag sorted by topic, decoded one by one."""

    def __init__(self, source: Source, names: Names, uavs: tuple[int, ...]) -> None:
        self.epochs: set[tuple[int, str]] = set()
        self._spool = DiskTrack()
        self.counted = DiagnosticCounters(self._spool)
        self._source = source
        self._names = names
        self._uavs = uavs
        self._tracks: dict[str, Writer] = {}
        self._decoders: dict[str, Callable[[bytes], Stamped]] = {}
        for uav in uavs:
            self._decoders[names.of(names.odom, uav)] = decode_odometry
            self._decoders[names.of(names.estimate, uav)] = decode_odometry
            self._decoders[names.of(names.truth, uav)] = decode_odometry
            self._decoders[names.of(names.wrench, uav)] = decode_wrench

    def collect(self) -> None:
        """Take in all that is wanted and there."""
        names = [*self._decoders, topics.EPOCH.name, topics.DIAGNOSTICS.name]
        types = self._source.types()
        for message in self._source.messages([name for name in names if name in types]):
            try:
                self._take(message)
            except WireError as error:
                raise BagError(
                    f"{self._source.path}: a message on {message.topic}: {error}"
                ) from None

    def _take(self, message: BagMessage) -> None:
        topic, data = message.topic, message.data
        if topic == topics.EPOCH.name:
            epoch = decode_header(data)
            self.epochs.add((epoch.stamp_ns, epoch.frame_id))
        elif topic == topics.DIAGNOSTICS.name:
            self.counted.take(decode_diagnostics(data))
        else:
            if topic not in self._tracks:
                self._tracks[topic] = Writer(self._spool)
            told = self._decoders[topic](data)
            self._tracks[topic].add(told.stamp_ns, message.stamp_ns, told.values)

    def tracks(self, pattern: str) -> dict[int, Track]:
        """What each UAV said on one of its topics."""
        topics_of = {uav: self._names.of(pattern, uav) for uav in self._uavs}
        held = {uav: topic for uav, topic in topics_of.items() if topic in self._tracks}
        return {uav: self._tracks[topic].track() for uav, topic in held.items()}


def _number(values: dict[str, str], key: str) -> float:
    try:
        return float(values.get(key, "0"))
    except ValueError:
        return 0.0


def _latency(status: DiagnosticStatus) -> dict[str, float]:
    found = {key: _LATENCY.fullmatch(key) for key in status.values}
    figures = {m[1]: _number(status.values, key) for key, m in found.items() if m}
    return figures if any(figures.values()) else {}  # lock-step has no latency


def read_recording(
    path: Path,
    scenario: Path | None = None,
    names: Names = OURS,
    epoch_s: float | None = None,
) -> Recording:
    """Everything the verdict needs from a bag, ours or another's.

    Args:
        path: the bag's folder or .mcap file.
        scenario: a scenario file instead of the one attached.
        names: which topics hold what.
        epoch_s: where the formation leg begins, after the first odometry; for bags without epochs.

    Raises:
        BagError: no bag, cut, damaged, or without a scenario.
    """
    source = open_source(path, SCENARIO_ATTACHMENT)
    flown = _scenario(source, scenario)
    check_types(source, names, flown)
    collector = _Collector(source, names, flown.uav_ids)
    collector.collect()
    odometry = collector.tracks(names.odom)
    epochs = tuple(sorted(collector.epochs))
    if epoch_s is not None and odometry:
        first_ns = min(track.first_ns for track in odometry.values())
        epochs = ((first_ns + round(epoch_s * 1e9), FORMATION),)
    return Recording(
        scenario=flown,
        odometry=odometry,
        wrench=collector.tracks(names.wrench),
        estimate=collector.tracks(names.estimate),
        truth=collector.tracks(names.truth),
        counters=collector.counted.counters(),
        sent=collector.counted.sent(),
        epochs=epochs,
        latency=collector.counted.latency,
    )
