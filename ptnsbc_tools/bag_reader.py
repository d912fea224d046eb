"""A bag as a Recording: the only place where the verdict meets messages."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_nodes import topics
from ptnsbc_nodes.bag import Bag, BagError, read_bag
from ptnsbc_nodes.wire import Stamped, decode_header, decode_odometry, decode_wrench
from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text
from ptnsbc_tools.diagnostics import Diagnostics, decode_diagnostics
from ptnsbc_tools.verdict import Counters, Recording, Series

SCENARIO_ATTACHMENT = "scenario.yaml"

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


class _Collector:
    """Messages of a bag sorted into lists, decoded one by one."""

    def __init__(self, uavs: tuple[int, ...]) -> None:
        self.series: dict[str, list[Stamped]] = {}
        self.epochs: list[tuple[int, str]] = []
        self.statuses: list[Diagnostics] = []
        self.decoders: dict[str, Callable[[bytes], Stamped]] = {}
        for uav in uavs:
            self.decoders[topics.odom(uav).name] = decode_odometry
            self.decoders[topics.leader_estimate(uav).name] = decode_odometry
            self.decoders[topics.wrench_setpoint(uav).name] = decode_wrench

    def wanted(self, bag: Bag) -> list[str]:
        names = [*self.decoders, topics.EPOCH.name, topics.DIAGNOSTICS.name]
        return [name for name in names if name in bag.topics]

    def take(self, topic: str, data: bytes) -> None:
        if topic == topics.EPOCH.name:
            epoch = decode_header(data)
            self.epochs.append((epoch.stamp_ns, epoch.frame_id))
        elif topic == topics.DIAGNOSTICS.name:
            self.statuses.append(decode_diagnostics(data))
        else:
            self.series.setdefault(topic, []).append(self.decoders[topic](data))

    def track(self, topic: topics.Topic) -> Series | None:
        messages = self.series.get(topic.name)
        if not messages:
            return None
        stamps = np.array([message.stamp_ns for message in messages], dtype=np.int64)
        values = np.stack([message.values for message in messages])
        # A stamp may come twice, when a link repeats; the last one is what counted.
        stamps, first = np.unique(stamps[::-1], return_index=True)
        return Series(stamps, values[::-1][first])

    def tracks(self, uavs: tuple[int, ...], of: Callable[[int], topics.Topic]) -> dict[int, Series]:
        found = {uav: self.track(of(uav)) for uav in uavs}
        return {uav: series for uav, series in found.items() if series is not None}


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


def read_recording(path: Path, scenario: Path | None = None) -> Recording:
    """Everything the verdict needs from a bag.

    Args:
        path: the bag's folder or .mcap file.
        scenario: a scenario file instead of the one attached.

    Raises:
        BagError: no bag, cut, damaged, or without a scenario.
    """
    bag = read_bag(path)
    flown = scenario_of(bag, scenario)
    collector = _Collector(flown.uav_ids)
    for message in bag.messages(collector.wanted(bag)):
        collector.take(message.topic, message.data)
    return Recording(
        scenario=flown,
        odometry=collector.tracks(flown.uav_ids, topics.odom),
        wrench=collector.tracks(flown.uav_ids, topics.wrench_setpoint),
        estimate=collector.tracks(flown.uav_ids, topics.leader_estimate),
        counters=_counters(collector.statuses),
        epochs=tuple(sorted(set(collector.epochs))),
        latency=_latency(collector.statuses),
    )
