"""What the nodes told about themselves over time, from /diagnostics: gains, latency, missed ticks."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ptnsbc_nodes import topics
from ptnsbc_nodes.bag import read_bag
from ptnsbc_nodes.wire import WireError
from ptnsbc_tools.diagnostics import Diagnostics, decode_diagnostics
from ptnsbc_tools.verdict import Series

_PLANNER = re.compile(r"uav(\d+): planner")
_SIM = "sim: world"
PLANNER_KEYS = ("gain", "sigma_min", "missed_ticks")
SIM_KEYS = ("latency_p50_ms", "latency_p99_ms", "latency_max_ms", "missed_ticks")


@dataclass(frozen=True)
class Status:
    """Values over time; a key that nobody told is missing."""

    planner: Mapping[int, Mapping[str, Series]] = field(default_factory=dict)  # by UAV, by key
    sim: Mapping[str, Series] = field(default_factory=dict)  # by key


class _Rows:
    """Samples by key, as they come."""

    def __init__(self) -> None:
        self._t: dict[str, list[int]] = {}
        self._values: dict[str, list[float]] = {}

    def add(self, stamp_ns: int, keys: Iterable[str], values: Mapping[str, str]) -> None:
        for key in keys:
            try:
                value = float(values[key])
            except (KeyError, ValueError):
                continue
            if math.isfinite(value):
                self._t.setdefault(key, []).append(stamp_ns)
                self._values.setdefault(key, []).append(value)

    def series(self) -> dict[str, Series]:
        found = {}
        for key, stamps in self._t.items():
            t_ns, first = np.unique(np.array(stamps, dtype=np.int64), return_index=True)
            found[key] = Series(t_ns, np.array(self._values[key])[first][:, None])
        return found


def status_of(arrays: Iterable[Diagnostics]) -> Status:
    """Sorted by node and by key."""
    planners: dict[int, _Rows] = {}
    sim = _Rows()
    for array in arrays:
        for status in array.statuses:
            match = _PLANNER.fullmatch(status.name)
            if match:
                rows = planners.setdefault(int(match[1]), _Rows())
                rows.add(array.stamp_ns, PLANNER_KEYS, status.values)
            elif status.name == _SIM:
                sim.add(array.stamp_ns, SIM_KEYS, status.values)
    planner = {uav: rows.series() for uav, rows in sorted(planners.items())}
    return Status(planner, sim.series())


def read_status(path: Path) -> Status:
    """The status of a bag's nodes; empty where none was recorded."""
    bag = read_bag(path)
    if topics.DIAGNOSTICS.name not in bag.topics:
        return Status()
    arrays = []
    for message in bag.messages([topics.DIAGNOSTICS.name]):
        try:
            arrays.append(decode_diagnostics(message.data))
        except WireError:  # nothing is judged here
            continue
    return status_of(arrays)
