"""A bag as a Recording: the only place where the verdict meets messages."""

from __future__ import annotations

import re
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


class _Collector:
    """Messages of a bag sorted into lists, decoded one by one."""

    def __init__(self, source: Source, names: Names, uavs: tuple[int, ...]) -> None:
        self.epochs: list[tuple[int, str]] = []
        self.statuses: list[Diagnostics] = []
        self._source = source
        self._names = names
        self._uavs = uavs
        self._series: dict[str, list[Stamped]] = {}
        self._logged: dict[str, list[int]] = {}
        self._decoders: dict[str, Callable[[bytes], Stamped]] = {}
        for uav in uavs:
            self._decoders[names.of(names.odom, uav)] = decode_odometry
            self._decoders[names.of(names.estimate, uav)] = decode_odometry
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
            self._series.setdefault(topic, []).append(self._decoders[topic](data))
            self._logged.setdefault(topic, []).append(message.stamp_ns)

    def tracks(self, pattern: str) -> dict[int, Series]:
        """What each UAV said on one of its topics."""
        found = {uav: self._track(self._names.of(pattern, uav)) for uav in self._uavs}
        return {uav: series for uav, series in found.items() if series is not None}

    def _track(self, topic: str) -> Series | None:
        messages = self._series.get(topic)
        if not messages:
            return None
        stamps = np.array([message.stamp_ns for message in messages], dtype=np.int64)
        if stamps.size > 1 and not stamps.any():  # whoever sent them left the header empty
            stamps = np.array(self._logged[topic], dtype=np.int64)
        values = np.stack([message.values for message in messages])
        # A stamp may come twice, when a link repeats; the last one is what counted.
        stamps, first = np.unique(stamps[::-1], return_index=True)
        return Series(stamps, values[::-1][first])


def _number(values: dict[str, str], key: str) -> float:
    try:
        return float(values.get(key, "0"))
    except ValueError:
        return 0.0


def _counters(statuses: list[Diagnostics]) -> dict[int, Counters]:
    rows: dict[int, list[tuple[int, dict[str, str]]]] = {}
    for array in statuses:
        for status in array.statuses:
            match = _PLANNER.fullmatch(status.name)
            if match and array.stamp_ns >= 0:
                rows.setdefault(int(match[1]), []).append((array.stamp_ns, status.values))
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


def _latency(statuses: list[Diagnostics]) -> dict[str, float]:
    for array in reversed(statuses):
        for status in array.statuses:
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
        counters=_counters(collector.statuses),
        epochs=epochs,
        latency=_latency(collector.statuses),
    )
