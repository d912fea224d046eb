"""The times in which a formation error does not count: a UAV, or an ancestor of it, avoids something.

An encounter of a UAV is a span in which its counter `avoidance_active_s` (/diagnostics, 5 Hz) rises, or
the counter of any of its ancestors in the tree. It begins at the last sample before the rise. It lasts
until one second plus three time constants of the formation loop, 3 / (Lambda kappa), after the last rise:
the time that the loop needs to bring the error back. An encounter that begins after the deadline excuses an
exit from the tolerance band. An encounter that lasts over the deadline makes a missed deadline void.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.build import loop_of
from ptnsbc_sim.verdict.recording import COUNTERS
from ptnsbc_sim.verdict.track import Track

Window = tuple[int, int]  # [ns], inclusive

_ACTIVE = COUNTERS.index("avoidance_active_s")
_PAUSE_S = 1.0
_TIME_CONSTANTS = 3.0
_SLOWEST_RECOVERY_S = 10.0  # without kappa the loop would never recover


def recovery_s(scenario: Scenario) -> float:
    """How long after its end an encounter still excuses the error."""
    loop = loop_of(scenario, scenario.gains.formation)  # as flown
    rate = loop.scale * loop.kappa
    return _PAUSE_S + min(_TIME_CONSTANTS / rate if rate > 0 else np.inf, _SLOWEST_RECOVERY_S)


def avoidance_windows(counters: Track) -> list[Window]:
    """Spans in which a UAV was avoiding something."""
    found: list[Window] = []
    last_ns, last = np.empty(0, np.int64), np.empty(0)
    for block in counters.blocks():
        stamps = np.concatenate((last_ns, block.t_ns))
        active = np.concatenate((last, block.values[:, _ACTIVE]))
        rises = np.flatnonzero(active[1:] > active[:-1])
        found = merged([*found, *((int(stamps[k]), int(stamps[k + 1])) for k in rises)])
        last_ns, last = stamps[-1:], active[-1:]
    return found


def merged(windows: Iterable[Window]) -> list[Window]:
    """Windows without overlap: those that overlap become one."""
    result: list[Window] = []
    for begin, end in sorted(windows):
        if result and begin <= result[-1][1]:
            result[-1] = (result[-1][0], max(end, result[-1][1]))
        else:
            result.append((begin, end))
    return result


def ancestors(scenario: Scenario, uav_id: int) -> list[int]:
    """The UAV itself, its parent, and so on up to the leader."""
    chain = [uav_id]
    parent = scenario.parent(uav_id)
    while parent is not None and parent not in chain:
        chain.append(parent)
        parent = scenario.parent(parent)
    return chain


def encounters(scenario: Scenario, counters: Mapping[int, Track]) -> dict[int, list[Window]]:
    """Encounters of every UAV, recovery included."""
    extra_ns = round(recovery_s(scenario) * 1e9)
    own = {uav: avoidance_windows(track) for uav, track in counters.items()}
    return {
        uav_id: merged(
            (begin, end + extra_ns)
            for uav in ancestors(scenario, uav_id)
            for begin, end in own.get(uav, ())
        )
        for uav_id in scenario.uav_ids
    }


def inside(windows: Iterable[Window], t_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which instants (T,) lie in any of the windows."""
    mask = np.zeros(t_ns.shape, dtype=np.bool_)
    for begin, end in windows:
        mask |= (t_ns >= begin) & (t_ns <= end)
    return mask
