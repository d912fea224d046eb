"""Reads a bag into a Recording, the input of the verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ptnsbc_io.bag import BagError, BagMessage
from ptnsbc_io.wire import (
    Stamped,
    WireError,
    decode_diagnostics,
    decode_header,
    decode_odometry,
    decode_wrench,
)
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import DecidedSlots, keep_recorded
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.verdict import Recording, Track
from ptnsbc_sim.verdict.recording import FORMATION, with_landing, with_said, with_taken
from ptnsbc_tools.limits import SHORTEST_WINDOW_S, refuse_outside
from ptnsbc_tools.reading.bag_sources import (
    OUR_TOPICS,
    BagSource,
    TopicNames,
    check_types,
    open_source,
    scenario_of,
)
from ptnsbc_tools.reading.diagnostics import DiagnosticCounters
from ptnsbc_tools.reading.disk_track import SampleFile, TrackWriters


@dataclass(frozen=True)
class ReadOptions:
    """The options with which a bag is read and judged.

    Args:
        scenario: scenario file to use instead of the attached one.
        tolerance: limit of the error at the deadline [m], by default that of the scenario.
        window_s: judge only the first seconds of each leg.
        epoch_s: epoch of the formation leg after the first odometry, for bags without epochs.
        names: names of the topics.

    Raises:
        LimitError: a time that no bag reaches.
    """

    scenario: Path | None = None
    tolerance: float | None = None
    window_s: float | None = None
    epoch_s: float | None = None
    names: TopicNames = OUR_TOPICS

    def __post_init__(self) -> None:
        refuse_outside("window_s", self.window_s, SHORTEST_WINDOW_S)
        refuse_outside("epoch_s", self.epoch_s)


DEFAULTS = ReadOptions()


class _Collector:
    """Decodes the messages of a bag one by one and sorts them by topic."""

    def __init__(self, source: BagSource, names: TopicNames, scenario: Scenario) -> None:
        uavs = scenario.uav_ids
        self.epochs: set[tuple[int, str]] = set()
        self.taken: list[Stamped] = []
        self.slots = DecidedSlots(scenario)
        file = SampleFile()
        self.counters = DiagnosticCounters(file)
        self._source = source
        self._names = names
        self._uavs = uavs
        self._samples = TrackWriters[str](file)
        self._decoders: dict[str, Callable[[bytes], Stamped]] = {}
        for uav in uavs:
            for pattern in (names.odom, names.estimate, names.truth):
                self._decoders[names.of(pattern, uav)] = decode_odometry
            self._decoders[names.of(names.wrench, uav)] = decode_wrench

    def collect(self) -> None:
        """Read all messages that the verdict needs."""
        common = (
            topics.EPOCH.name,
            topics.SLOTS.name,
            topics.TAKEN.name,
            topics.DIAGNOSTICS.name,
        )
        names = [*self._decoders, *common]
        types = self._source.types()
        for message in self._source.messages([name for name in names if name in types]):
            try:
                self._add(message)
            except WireError as error:
                raise BagError(
                    f"{self._source.path}: a message on {message.topic}: {error}"
                ) from None
        self._tracks = self._samples.tracks()

    def _add(self, message: BagMessage) -> None:
        topic, data = message.topic, message.data
        if topic == topics.EPOCH.name:
            epoch = decode_header(data)
            self.epochs.add((epoch.stamp_ns, epoch.frame_id))
        elif topic == topics.SLOTS.name:
            keep_recorded(self.slots, data)
        elif topic == topics.TAKEN.name:
            self.taken.append(decode_odometry(data))
        elif topic == topics.DIAGNOSTICS.name:
            self.counters.add(decode_diagnostics(data))
        else:
            sample = self._decoders[topic](data)
            self._samples.add(topic, sample.stamp_ns, sample.values, message.stamp_ns)

    def tracks(self, pattern: str) -> dict[int, Track]:
        """The recorded tracks of one topic by UAV."""
        topics_of = {uav: self._names.of(pattern, uav) for uav in self._uavs}
        return {uav: self._tracks[name] for uav, name in topics_of.items() if name in self._tracks}


def read_recording(path: Path, options: ReadOptions = DEFAULTS) -> Recording:
    """Everything that the verdict needs from a bag, whoever recorded it.

    Args:
        path: the bag's folder or .mcap file.
        options: how it is read.

    Raises:
        BagError: no bag, cut, damaged, or without a scenario.
    """
    names = options.names
    source = open_source(path)
    scenario = scenario_of(source, options.scenario)
    check_types(source, names, scenario)
    collector = _Collector(source, names, scenario)
    collector.collect()
    odometry = collector.tracks(names.odom)
    epochs = tuple(sorted(collector.epochs))
    slots = {t0_ns: found for t0_ns, _ in epochs if (found := collector.slots.of(t0_ns))}
    if options.epoch_s is not None and odometry:
        first_ns = min(track.first_ns for track in odometry.values())
        epochs = ((first_ns + round(options.epoch_s * 1e9), FORMATION),)
    scenario = with_taken(scenario, epochs, collector.taken)
    scenario, epochs = with_said(scenario, epochs)
    return Recording(
        scenario=scenario,
        odometry=odometry,
        wrench=collector.tracks(names.wrench),
        estimate=collector.tracks(names.estimate),
        truth=collector.tracks(names.truth),
        counters=collector.counters.counters(),
        sent=collector.counters.sent(),
        epochs=with_landing(scenario, epochs),
        slots=slots,
        latency=collector.counters.latency,
        injected=tuple(collector.counters.injected),
        window_s=options.window_s,
    )
