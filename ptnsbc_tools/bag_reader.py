"""A bag as a Recording: the only place where the verdict meets messages."""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_nodes import topics
from ptnsbc_nodes.bag import Bag, BagError, BagMessage
from ptnsbc_nodes.wire import (
    Stamped,
    WireError,
    decode_header,
    decode_odometry,
    decode_wrench,
)
from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text
from ptnsbc_tools.diagnostics import Diagnostics, decode_diagnostics
from ptnsbc_tools.foreign import Names, Source, check_types, open_source
from ptnsbc_tools.verdict import Counters, Recording, Series
from ptnsbc_tools.verdict.recording import FORMATION

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


class _Track:
    """Numbers of one topic, packed: a long flight must not become millions of objects."""

    def __init__(self) -> None:
        self._stamps = array("q")
        self._logged = array("q")
        self._values = array("d")
        self._width = 0

    def add(self, message: Stamped, log_ns: int) -> None:
        self._stamps.append(message.stamp_ns)
        self._logged.append(log_ns)
        self._values.frombytes(message.values.tobytes())
        self._width = message.values.size

    def series(self) -> Series:
        stamps = np.frombuffer(self._stamps, np.int64)
        if stamps.size > 1 and not stamps.any():  # whoever sent them left the header empty
            stamps = np.frombuffer(self._logged, np.int64)
        values = np.frombuffer(self._values, np.float64).reshape(-1, self._width)
        # A stamp may come twice, when a link repeats; the last one is what counted.
        stamps, first = np.unique(stamps[::-1], return_index=True)
        return Series(stamps, values[::-1][first])


class _Collector:
    """Messages of a bag sorted by topic, decoded one by one."""

    def __init__(self, source: Source, names: Names, uavs: tuple[int, ...]) -> None:
        self.epochs: list[tuple[int, str]] = []
        self.statuses: list[Diagnostics] = []
        self._source = source
        self._names = names
        self._uavs = uavs
        self._tracks: dict[str, _Track] = {}
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
            self.epochs.append((epoch.stamp_ns, epoch.frame_id))
        elif topic == topics.DIAGNOSTICS.name:
            self.statuses.append(decode_diagnostics(data))
        else:
            track = self._tracks.setdefault(topic, _Track())
            track.add(self._decoders[topic](data), message.stamp_ns)

    def tracks(self, pattern: str) -> dict[int, Series]:
        """What each UAV said on one of its topics."""
        topics_of = {uav: self._names.of(pattern, uav) for uav in self._uavs}
        held = {uav: topic for uav, topic in topics_of.items() if topic in self._tracks}
        return {uav: self._tracks[topic].series() for uav, topic in held.items()}


def _number(values: dict[str, str], key: str) -> float:
    try:
        return float(values.get(key, "0"))
    except ValueError:
        return 0.0


def _counters(statuses: list[Diagnostics]) -> dict[int, Counters]:
    rows: dict[int, list[tuple[int, dict[str, str]]]] = {}
    for told in statuses:
        for status in told.statuses:
            match = _PLANNER.fullmatch(status.name)
            if match and told.stamp_ns >= 0:
                rows.setdefault(int(match[1]), []).append((told.stamp_ns, status.values))
    return {uav: _counter(sorted(found, key=lambda row: row[0])) for uav, found in rows.items()}


def _counter(rows: list[tuple[int, dict[str, str]]]) -> Counters:
    def column(key: str) -> Array:
        return np.array([_number(values, key) for _, values in rows])

    return Counters(
        np.array([stamp for stamp, _ in rows], dtype=np.int64),
        column("avoidance_active_s"),
        column("saturated_s"),
        column("holding_s"),
        column("missed_ticks"),
        column("priority_violation_max"),
    )


def _sent(statuses: list[Diagnostics]) -> dict[int, Series]:
    """Odometry messages that each bridge had sent (T, 1), and the stamp of the newest of them."""
    counts: dict[int, dict[int, int]] = {}
    for told in statuses:
        for status in told.statuses:
            match = _LINK.fullmatch(status.name)
            stamp, _, count = status.values.get("states_sent", "").partition(" ")
            if match and stamp.isdecimal() and count.isdecimal() and int(count):
                counts.setdefault(int(match[1]), {})[int(stamp)] = int(count)
    return {uav: _series(found) for uav, found in counts.items()}


def _series(counts: dict[int, int]) -> Series:
    stamps = sorted(counts)
    values = np.array([[float(counts[stamp])] for stamp in stamps])
    return Series(np.array(stamps, dtype=np.int64), values)


def _latency(statuses: list[Diagnostics]) -> dict[str, float]:
    for told in reversed(statuses):
        for status in told.statuses:
            if status.name == _SIM:
                found = {key: _LATENCY.fullmatch(key) for key in status.values}
                figures = {m[1]: _number(status.values, key) for key, m in found.items() if m}
                return figures if any(figures.values()) else {}  # lock-step has no latency
    return {}


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
    epochs = tuple(sorted(set(collector.epochs)))
    if epoch_s is not None and odometry:
        first_ns = min(int(series.t_ns[0]) for series in odometry.values())
        epochs = ((first_ns + round(epoch_s * 1e9), FORMATION),)
    return Recording(
        scenario=flown,
        odometry=odometry,
        wrench=collector.tracks(names.wrench),
        estimate=collector.tracks(names.estimate),
        truth=collector.tracks(names.truth),
        counters=_counters(collector.statuses),
        sent=_sent(collector.statuses),
        epochs=epochs,
        latency=_latency(collector.statuses),
    )
