"""Reads a bag of any kind into a Recording, the input of the verdict, and into the values that its nodes published."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ptnsbc_core.nanoseconds import nanoseconds
from ptnsbc_io.bag import Bag, BagError, BagMessage, read_bag
from ptnsbc_io.wire import (
    Diagnostics,
    Stamped,
    WireError,
    decode_diagnostics,
    decode_header,
    decode_integers,
    decode_odometry,
    decode_wrench,
)
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import DecidedSlots, keep_recorded
from ptnsbc_nodes.uav.step_log import TickNote, tick_note
from ptnsbc_sim.counters import COUNTERS
from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text
from ptnsbc_sim.verdict import Recording, Track
from ptnsbc_sim.verdict.recording import FORMATION, with_landing, with_said, with_taken
from ptnsbc_tools.options import AS_RECORDED, UAV, ReadOptions
from ptnsbc_tools.reading.disk_track import SampleFile, TrackWriters
from ptnsbc_tools.reading.vehicle_states import Decoder, state_readers

SCENARIO_ATTACHMENT = "scenario.yaml"
_PLANNER = re.compile(r"uav([0-9]{1,3}): planner")
_LINK = re.compile(r"bridge([0-9]{1,3}): link")
_STATES_SENT = re.compile(r"([0-9]{1,19}) ([1-9][0-9]{0,14})")  # stamp [ns], number of messages
_LAST_NS = 2**63 - 1
_SIM = "sim: world"
_LATENCY = re.compile(r"latency_(\w+)_ms")
_TICK = re.compile(r"/uav([0-9]{1,3})/tick")
_SENSORS = ("own", "near")  # the messages of a step that no neighbour sent
_PLANNER_KEYS = ("gain", "sigma_min", "missed_ticks")
_STATES: Mapping[str, Decoder] = {topics.odom(1).type: lambda data, _: decode_odometry(data)}
_WRENCHES: Mapping[str, Decoder] = {
    topics.wrench_setpoint(1).type: lambda data, _: decode_wrench(data)
}
_SIM_KEYS = ("latency_p50_ms", "latency_p99_ms", "latency_max_ms")


def scenario_of(bag: Bag, given: Path | None) -> Scenario:
    """The scenario with which a bag was flown: the given file, else the attached one."""
    if given is not None:
        return load_scenario(given)
    if SCENARIO_ATTACHMENT not in bag.attachments:
        raise BagError(
            f"{bag.path}: no {SCENARIO_ATTACHMENT} attached: give the scenario file "
            "with which it was flown, as verify, report, plot, export and bag replay take it"
        )
    text = bag.attachment(SCENARIO_ATTACHMENT).decode("utf-8", errors="replace")
    source = f"{bag.path.name}:{SCENARIO_ATTACHMENT}"
    return scenario_from_text(text, source=source, complete=True)


def _number(values: Mapping[str, str], key: str, default: float) -> float:
    """A finite number of a status; the default for anything else."""
    try:
        found = float(values[key])
    except (KeyError, ValueError):
        return default
    return found if math.isfinite(found) else default


class DiagnosticCounters:
    """The counters of UAVs and bridges, and the newest latency figures of the sim, for the verdict."""

    def __init__(self, file: SampleFile) -> None:
        self.latency: dict[str, float] = {}
        self.counters = TrackWriters[int](file)  # `COUNTERS` of each UAV
        self.sent = TrackWriters[int](file)
        """Odometry messages that each bridge had sent (T, 1), at the stamp of the newest of them."""

    def add(self, array: Diagnostics) -> None:
        """Take an array of diagnostics."""
        for status in array.statuses:
            if planner := _PLANNER.fullmatch(status.name):
                if array.stamp_ns >= 0:
                    values = np.array([_number(status.values, key, 0.0) for key in COUNTERS])
                    self.counters.add(int(planner[1]), array.stamp_ns, values)
            elif link := _LINK.fullmatch(status.name):
                sent = _STATES_SENT.fullmatch(status.values.get("states_sent", ""))
                if sent and int(sent[1]) <= _LAST_NS:
                    self.sent.add(int(link[1]), int(sent[1]), np.array([float(sent[2])]))
            elif status.name == _SIM:
                found = {key: _LATENCY.fullmatch(key) for key in status.values}
                figures = {m[1]: _number(status.values, key, 0.0) for key, m in found.items() if m}
                # Lock-step has no latency.
                self.latency = figures if any(figures.values()) else {}


StatusSeries = dict[str, dict[int, Track]]
"""Values (T, 1) that the nodes published over time, by key and by UAV; 0 is the sim. `age_ms` is of the steps."""


class StatusCollector:
    """Collects the values of the nodes for figures."""

    def __init__(self) -> None:
        self._values = TrackWriters[tuple[str, int]](SampleFile())

    def add_diagnostics(self, array: Diagnostics) -> None:
        """Take an array of diagnostics."""
        for status in array.statuses:
            planner = _PLANNER.fullmatch(status.name)
            keys = _PLANNER_KEYS if planner else _SIM_KEYS if status.name == _SIM else ()
            for key in keys:
                value = _number(status.values, key, math.nan)
                if not math.isnan(value):
                    uav = int(planner[1]) if planner else 0
                    self._values.add((key, uav), array.stamp_ns, np.array([value]))

    def add_tick(self, uav: int, note: TickNote) -> None:
        """Take the age [ms] of the oldest message of a neighbour that went into a step."""
        stamps = [used.stamp_ns for name, used in note.used.items() if name not in _SENSORS]
        if stamps:
            now_ns = note.moment.now_ns
            self._values.add(("age_ms", uav), now_ns, np.array([(now_ns - min(stamps)) * 1e-6]))

    def series(self) -> StatusSeries:
        """The values collected."""
        found: StatusSeries = {}
        for (key, uav), track in self._values.tracks().items():
            found.setdefault(key, {})[uav] = track
        return found


def read_status(path: Path) -> StatusSeries:
    """The values that the nodes of a bag published; empty where none was recorded."""
    bag, collector = read_bag(path), StatusCollector()
    ticks = {name: int(found[1]) for name in bag.topics if (found := _TICK.fullmatch(name))}
    wanted = [name for name in (topics.DIAGNOSTICS.name, *ticks) if name in bag.topics]
    for message in bag.messages(wanted):
        try:
            if message.topic == topics.DIAGNOSTICS.name:
                collector.add_diagnostics(decode_diagnostics(message.data))
            else:
                row = decode_integers(message.data)
                collector.add_tick(ticks[message.topic], tick_note(row.label, row.values.tolist()))
        except WireError:  # figures leave a broken message out; the verdict names it
            continue
    return collector.series()


class _Collector:
    """Decodes the messages of a bag one by one and sorts them by topic."""

    def __init__(self, bag: Bag, options: ReadOptions, scenario: Scenario) -> None:
        self.epochs: set[tuple[int, str]] = set()
        self.taken: list[Stamped] = []
        self.slots = DecidedSlots(scenario)
        file = SampleFile()
        self.counters = DiagnosticCounters(file)
        self.left_out: list[str] = []  # in words
        self._samples = TrackWriters[tuple[str, int]](file)  # by field of `Recording`, by UAV
        self._decoders: dict[str, list[tuple[tuple[str, int], Decoder]]] = defaultdict(list)
        self.sources = state_readers(options, scenario)
        for uav, source in self.sources.items():
            wrench = options.wrench.replace(UAV, str(uav))
            for goes_to, name, decoders in (
                ("odometry", source.topic, source.decoders),
                ("wrench", wrench, _WRENCHES),
                ("estimate", topics.leader_estimate(uav).name, _STATES),
                ("truth", topics.truth(uav).name, _STATES),
            ):
                held = bag.topics.get(name)
                if held is None or not held.messages:
                    continue
                if held.type not in decoders:
                    expected = " or ".join(decoders)
                    raise BagError(f"{bag.path}: {name} is {held.type}: expected {expected}")
                self._decoders[name].append(((goes_to, uav), decoders[held.type]))

    def collect(self, bag: Bag) -> None:
        common = (topics.EPOCH, topics.SLOTS, topics.TAKEN, topics.DIAGNOSTICS)
        names = [*self._decoders, *(topic.name for topic in common)]
        damaged = 0
        for message in bag.messages([name for name in names if name in bag.topics]):
            try:
                self._add(message)
            except WireError as error:
                if message.topic != topics.DIAGNOSTICS.name:  # on which anybody may publish
                    raise BagError(f"{bag.path}: a message on {message.topic}: {error}") from None
                damaged += 1
        if damaged:
            self.left_out.append(f"{damaged} damaged on {topics.DIAGNOSTICS.name}, left out")
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
            for key, decode in self._decoders[topic]:
                sample = decode(data, message.stamp_ns)
                if sample is not None:
                    self._samples.add(key, sample.stamp_ns, sample.values, message.stamp_ns)

    def tracks(self, field: str) -> dict[int, Track]:
        """The recorded tracks of one field of `Recording` by UAV."""
        found = {uav: self._tracks.get((field, uav)) for uav in self.sources}
        return {uav: track for uav, track in found.items() if track is not None}


def read_recording(path: Path, options: ReadOptions = AS_RECORDED) -> Recording:
    """Everything that the verdict needs from a bag (its folder, or an .mcap file), whoever recorded it.

    Raises:
        BagError: no bag, cut, damaged, or without a scenario.
    """
    bag = read_bag(path)
    scenario = scenario_of(bag, options.scenario)
    collector = _Collector(bag, options, scenario)
    collector.collect(bag)
    odometry = collector.tracks("odometry")
    epochs = tuple(sorted(collector.epochs))
    slots = {t0_ns: found for t0_ns, _ in epochs if (found := collector.slots.of(t0_ns))}
    if options.epoch_s is not None and odometry:
        first_ns = min(track.first_ns for track in odometry.values())
        epochs = ((first_ns + nanoseconds(options.epoch_s), FORMATION),)
    scenario = with_taken(scenario, epochs, collector.taken)
    scenario, epochs = with_said(scenario, epochs)
    return Recording(
        scenario=scenario,
        odometry=odometry,
        wrench=collector.tracks("wrench"),
        estimate=collector.tracks("estimate"),
        truth=collector.tracks("truth"),
        counters=collector.counters.counters.tracks(),
        sent=collector.counters.sent.tracks(),
        epochs=with_landing(scenario, epochs),
        slots=slots,
        latency=collector.counters.latency,
        left_out=tuple(collector.left_out),
        window_s=options.window_s,
        sources={uav: source.name for uav, source in collector.sources.items()},
    )
