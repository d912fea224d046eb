"""What the nodes told about themselves over time: gains, latency, missed ticks, age of messages."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ptnsbc_nodes import topics
from ptnsbc_nodes.ticklog import TickNote, tick_note
from ptnsbc_nodes.wire import WireError, decode_integers
from ptnsbc_tools.bag_reader import SCENARIO_ATTACHMENT
from ptnsbc_tools.diagnostics import Diagnostics, decode_diagnostics
from ptnsbc_tools.foreign import open_source
from ptnsbc_tools.verdict import Series

_STATUS = topics.DIAGNOSTICS.name
_TICK = re.compile(r"/uav(\d+)/tick")
_OWN = ("own", "near")  # of a step's messages, those that no neighbour sent
_PLANNER = re.compile(r"uav(\d+): planner")
_SIM = "sim: world"
PLANNER_KEYS = ("gain", "sigma_min", "missed_ticks")
SIM_KEYS = ("latency_p50_ms", "latency_p99_ms", "latency_max_ms", "missed_ticks")


@dataclass(frozen=True)
class Status:
    """Values over time; a key that nobody told is missing."""

    planner: Mapping[int, Mapping[str, Series]] = field(default_factory=dict)  # by UAV, by key
    sim: Mapping[str, Series] = field(default_factory=dict)  # by key
    age_ms: Mapping[int, Series] = field(default_factory=dict)  # (T, 1) by UAV, see `ages`


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


def ages(notes: Iterable[TickNote]) -> Series:
    """Age [ms] of the oldest message of a neighbour that went into each step (T, 1)."""
    found = {}
    for note in notes:
        stamps = [used.stamp_ns for name, used in note.used.items() if name not in _OWN]
        if stamps:
            found[note.moment.now_ns] = (note.moment.now_ns - min(stamps)) * 1e-6
    t_ns = np.array(sorted(found), dtype=np.int64)
    return Series(t_ns, np.array([found[int(t)] for t in t_ns]).reshape(-1, 1))


def read_status(path: Path) -> Status:
    """The status of a bag's nodes; empty where none was recorded."""
    source = open_source(path, SCENARIO_ATTACHMENT)
    types = source.types()
    arrays: list[Diagnostics] = []
    notes: dict[int, list[TickNote]] = {}
    ticks = {name: int(found[1]) for name in types if (found := _TICK.fullmatch(name))}
    for message in source.messages([name for name in (_STATUS, *ticks) if name in types]):
        try:
            if message.topic == _STATUS:
                arrays.append(decode_diagnostics(message.data))
            else:
                row = decode_integers(message.data)
                note = tick_note(row.label, row.values.tolist())
                notes.setdefault(ticks[message.topic], []).append(note)
        except WireError:  # nothing is judged here
            continue
    found_ages = {uav: ages(noted) for uav, noted in sorted(notes.items())}
    told = status_of(arrays)
    return Status(told.planner, told.sim, {uav: s for uav, s in found_ages.items() if s.t_ns.size})
