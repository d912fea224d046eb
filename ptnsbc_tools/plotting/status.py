"""What the nodes told about themselves over time: gains, latency, missed ticks, age of messages."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ptnsbc_io.wire import WireError, decode_integers
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.uav.step_log import TickNote, tick_note
from ptnsbc_tools.reading.bag_reader import SCENARIO_ATTACHMENT
from ptnsbc_tools.reading.diagnostics import Diagnostics, decode_diagnostics
from ptnsbc_tools.reading.disk_track import DiskTrack, Writer
from ptnsbc_tools.reading.foreign import open_source
from ptnsbc_tools.verdict import Track

_STATUS = topics.DIAGNOSTICS.name
_TICK = re.compile(r"/uav(\d+)/tick")
_OWN = ("own", "near")  # of a step's messages, those that no neighbour sent
_PLANNER = re.compile(r"uav(\d+): planner")
_SIM = "sim: world"
PLANNER_KEYS = ("gain", "sigma_min", "missed_ticks")
SIM_KEYS = ("latency_p50_ms", "latency_p99_ms", "latency_max_ms", "missed_ticks")


@dataclass(frozen=True)
class StatusSeries:
    """Values over time; a key that nobody told is missing."""

    planner: Mapping[int, Mapping[str, Track]] = field(default_factory=dict)  # by UAV, by key
    sim: Mapping[str, Track] = field(default_factory=dict)  # by key
    age_ms: Mapping[int, Track] = field(default_factory=dict)  # (T, 1) by UAV, see `ages`


class _Rows:
    """Samples by key, as they come."""

    def __init__(self, spool: DiskTrack) -> None:
        self._spool = spool
        self._tracks: dict[str, Writer] = {}

    def add(self, stamp_ns: int, keys: Iterable[str], values: Mapping[str, str]) -> None:
        for key in keys:
            try:
                value = float(values[key])
            except (KeyError, ValueError):
                continue
            if math.isfinite(value):
                if key not in self._tracks:
                    self._tracks[key] = Writer(self._spool)
                self._tracks[key].add(stamp_ns, stamp_ns, np.array([value]))

    def tracks(self) -> dict[str, Track]:
        return {key: written.track() for key, written in self._tracks.items()}


class StatusCollector:
    """Takes in what nodes tell, sorted by node and by key."""

    def __init__(self) -> None:
        self._spool = DiskTrack()
        self._planners: dict[int, _Rows] = {}
        self._sim = _Rows(self._spool)
        self._ages: dict[int, Writer] = {}

    def told(self, array: Diagnostics) -> None:
        """Take an array of diagnostics."""
        for status in array.statuses:
            match = _PLANNER.fullmatch(status.name)
            if match:
                rows = self._planners.setdefault(int(match[1]), _Rows(self._spool))
                rows.add(array.stamp_ns, PLANNER_KEYS, status.values)
            elif status.name == _SIM:
                self._sim.add(array.stamp_ns, SIM_KEYS, status.values)

    def noted(self, uav: int, note: TickNote) -> None:
        """Take the age [ms] of the oldest message of a neighbour that went into a step."""
        stamps = [used.stamp_ns for name, used in note.used.items() if name not in _OWN]
        if stamps:
            now_ns = note.moment.now_ns
            age_ms = np.array([(now_ns - min(stamps)) * 1e-6])
            if uav not in self._ages:
                self._ages[uav] = Writer(self._spool)
            self._ages[uav].add(now_ns, now_ns, age_ms)

    def status(self) -> StatusSeries:
        """All that was taken."""
        planner = {uav: rows.tracks() for uav, rows in sorted(self._planners.items())}
        ages = {uav: written.track() for uav, written in sorted(self._ages.items())}
        return StatusSeries(planner, self._sim.tracks(), ages)


def read_status(path: Path) -> StatusSeries:
    """The status of a bag's nodes; empty where none was recorded."""
    source = open_source(path, SCENARIO_ATTACHMENT)
    types = source.types()
    teller = StatusCollector()
    ticks = {name: int(found[1]) for name in types if (found := _TICK.fullmatch(name))}
    for message in source.messages([name for name in (_STATUS, *ticks) if name in types]):
        try:
            if message.topic == _STATUS:
                teller.told(decode_diagnostics(message.data))
            else:
                row = decode_integers(message.data)
                teller.noted(ticks[message.topic], tick_note(row.label, row.values.tolist()))
        except WireError:  # nothing is judged here
            continue
    return teller.status()
