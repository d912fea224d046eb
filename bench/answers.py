"""The answers to the faults of a flight, as its bag tells them: who held, and who named refused messages.

Every answer is read from /diagnostics, on which a UAV reports five times a second. So a limit is the time of
docs/faults.md and two reports. An answer that another fault may hide is left out: one that strikes the follower
itself meanwhile, or its parent just before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

from ptnsbc_io.bag import Bag
from ptnsbc_io.wire import decode_diagnostics
from ptnsbc_nodes.comm.diagnostics import STATUS_HZ
from ptnsbc_nodes.comm.topics import DIAGNOSTICS
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.faults import FaultBlock
from ptnsbc_sim.verdict.recording import COUNTERS, Recording

_REPORTS_S = 2.0 / STATUS_HZ
_SILENCING = ("silence", "nan", "freeze", "restart")
_BEGINS_WITHIN_S = 1.0  # the launcher carries out a restart


class Answer(NamedTuple):
    """The answer of a follower to a fault of its parent."""

    fault: str
    uav: int
    action: str  # "holds" or "names what it refuses"
    after_s: float | None  # from the begin of the fault; None: it did not
    within_s: float

    @property
    def late(self) -> bool:
        """True if it came after its limit, or never."""
        return self.after_s is None or self.after_s > self.within_s


class Report(NamedTuple):
    """The status of the planner of a UAV."""

    stamp_ns: int
    message: str


def answers(recording: Recording, bag: Bag) -> Iterator[Answer]:
    """The answers of all followers whose parents were struck by a fault that the table names."""
    scenario, reports = recording.scenario, _reports(bag)
    holds_s = float(scenario.file.communication.stale_s) + _REPORTS_S
    for fault in scenario.faults:
        if fault.kind not in _SILENCING or fault.struck_uav is None:
            continue
        start_ns = recording.start_ns + round(fault.at_s * 1e9)
        lasts_s = fault.duration_s or 0.0
        if fault.kind == "restart":
            lasts_s = absence_s(reports[fault.struck_uav], start_ns)
        for child in scenario.followers:
            if scenario.parent(child) != fault.struck_uav or _struck(scenario, child, fault):
                continue
            if fault.kind == "nan" and lasts_s >= _REPORTS_S:
                after_s = refused_after_s(reports[child], start_ns)
                yield Answer(fault.text, child, "names what it refuses", after_s, _REPORTS_S)
            if lasts_s >= holds_s:
                after_s = _held_after_s(recording, child, start_ns, lasts_s)
                yield Answer(fault.text, child, "holds", after_s, holds_s)


def absence_s(reports: Sequence[Report], start_ns: int) -> float:
    """For how long [s] a process that was killed at about `start_ns` was silent after that.

    It may have been heard by others up to one period of its reports before its first one.
    """
    begins_ns = start_ns + round(_BEGINS_WITHIN_S * 1e9)
    stamps = (report.stamp_ns for report in reports)
    gaps = [gap for gap in pairwise(stamps) if gap[0] < begins_ns and gap[1] > start_ns]
    _, back_ns = max(gaps, key=lambda gap: gap[1] - gap[0], default=(0, 0))
    return max((back_ns - start_ns) * 1e-9 - 1.0 / STATUS_HZ, 0.0)


def refused_after_s(reports: Sequence[Report], start_ns: int) -> float | None:
    """The time [s] from `start_ns` to the first report that names refused messages."""
    for report in reports:
        if report.stamp_ns > start_ns and "refused" in report.message:
            return (report.stamp_ns - start_ns) * 1e-9
    return None


def _held_after_s(recording: Recording, uav: int, start_ns: int, lasts_s: float) -> float | None:
    counters, column = recording.counters[uav], COUNTERS.index("holding_s")
    end_ns = start_ns + round((lasts_s + _REPORTS_S) * 1e9)
    first, last = counters.index(start_ns, "left"), counters.index(end_ns, "right")
    rows = counters.rows(max(first - 1, 0), last)
    held = rows.values[:, column]
    for t_ns, value in zip(rows.t_ns[1:], held[1:], strict=True):
        if value > held[0]:
            # The counter says for how long it has held at this status.
            return float(t_ns - start_ns) * 1e-9 - float(value - held[0])
    return None


def _struck(scenario: Scenario, child: int, fault: FaultBlock) -> bool:
    first_s, last_s = fault.at_s - 3.0, fault.at_s + (fault.duration_s or 0.0)
    return any(
        one is not fault
        and one.struck_uav in (child, fault.struck_uav)
        and one.at_s < last_s
        and one.at_s + (one.duration_s or 3.0) > first_s
        for one in scenario.faults
    )


def _reports(bag: Bag) -> Mapping[int, Sequence[Report]]:
    found: dict[int, list[Report]] = {}
    for message in bag.messages([DIAGNOSTICS.name]):
        array = decode_diagnostics(message.data)
        for status in array.statuses:
            uav, _, part = status.name.removeprefix("uav").partition(": ")
            if part == "planner" and uav.isdecimal():
                found.setdefault(int(uav), []).append(Report(array.stamp_ns, status.message))
    return found
