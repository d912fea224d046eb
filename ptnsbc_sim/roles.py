"""The changes of the place of a UAV in the graph, and the state that it keeps: docs/notes/membership.md."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.behaviours.neighbour import SILENT
from ptnsbc_core.behaviours.recovery import DISTURBED
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import NEVER_RECEIVED_S, AgentState, Array, NeighbourMotions, StartErrors
from ptnsbc_sim.disturbances.faults import gone
from ptnsbc_sim.disturbances.links import last_state_received
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.slots import Formations, Membership, View, changed

_ZERO = (0.0, 0.0, 0.0)


class RoleChange(NamedTuple):
    """One UAV has another place in the graph."""

    uav: int
    before: Scenario | None  # as it saw it; None: it was not there
    after: Scenario


def moved_on(state: AgentState, change: RoleChange) -> AgentState:
    """The state of a UAV whose place in the graph has changed.

    With another parent, slot or lead of its own it makes its way back: from where it is, with the velocity that it has,
    by a time base of its own. The estimate goes on, because the reference point of the formation stays.
    """
    moved, led = True, True
    if change.before is not None:
        moved, led = changed(change.before, change.after, change.uav)
    if moved:
        return state._replace(
            start=StartErrors(_ZERO, _ZERO, _ZERO, _ZERO),
            recovery=DISTURBED,
            motions=NeighbourMotions(SILENT, SILENT),
        )
    if led:
        return state._replace(motions=NeighbourMotions(state.motions.parent, SILENT))
    return state


class UavRole:
    """The place of one UAV in the graph, by the members that it sees, in a scenario in which UAVs may come and go."""

    def __init__(self, formations: Formations, uav: int) -> None:
        self.formations, self.uav = formations, uav
        self.restart(formations.scenario)

    def restart(self, known: Scenario | None) -> None:
        """Forget the members seen so far; `known`: the scenario as the UAV flies it, None while it has no place."""
        self.view = View(self.formations.scenario, self.uav)
        self.members = Membership(frozenset(), frozenset())
        self.flown = known

    def take(self, since_ns: int, awake_ns: int, ages_s: Mapping[int, float]) -> RoleChange | None:
        """Determine the members, as `View.at`; returns the new role of the UAV if it changes."""
        self.members = self.view.at(since_ns, awake_ns, ages_s)
        before, after = self.flown, self.formations.of(self.members)
        if self.uav in self.members.absent:
            self.flown = None
        elif after is not None and after is not before:
            self.flown = after
            return RoleChange(self.uav, before, after)
        return None


def role_changes(scenario: Scenario) -> dict[int, list[RoleChange]]:
    """The changes of a headless flight, by the tick from which they hold; none unless UAVs may come and go."""
    changes: dict[int, list[RoleChange]] = {}
    if not scenario.formation.reconfigures:
        return changes
    formations, dead = Formations(scenario), gone(scenario)
    for row, uav in enumerate(scenario.uav_ids):
        for tick, change in _changes(UavRole(formations, uav), dead[:, row]):
            changes.setdefault(tick, []).append(change)
    return changes


def _changes(role: UavRole, dead: NDArray[np.bool_]) -> Iterator[tuple[int, RoleChange]]:
    scenario, uav = role.formations.scenario, role.uav
    others = [other for other in scenario.uav_ids if other != uav]
    ticks = np.arange(scenario.timing.ticks, dtype=np.int64)
    woke = np.maximum.accumulate(np.where(dead, ticks + 1, 0))  # first tick of the process
    ages = {other: _ages(scenario, uav, other) for other in others}
    for tick in _looks(scenario, ages, dead, woke).tolist():
        if dead[tick]:
            continue
        if tick == woke[tick] > 0:  # a process that begins anew knows nothing
            role.restart(None)
        dt_ns = scenario.timing.dt_ns
        since_ns, awake_ns = tick * dt_ns, (tick - int(woke[tick])) * dt_ns
        ages_s = {other: float(of[tick]) for other, of in ages.items()}
        change = role.take(since_ns, awake_ns, ages_s)
        if change is not None:
            yield tick, change


def _ages(scenario: Scenario, uav: int, other: int) -> Array:
    """Age [s] of the newest state (T,) of another UAV at every tick."""
    sent = last_state_received(scenario, uav, other)
    age_s = seconds((np.arange(len(sent)) - sent) * scenario.timing.dt_ns)
    return np.asarray(np.where(sent >= 0, age_s, NEVER_RECEIVED_S), dtype=np.float64)


def _looks(
    scenario: Scenario, ages: Mapping[int, Array], dead: NDArray[np.bool_], woke: NDArray[np.int64]
) -> NDArray[np.int64]:
    """The ticks at which what a UAV sees may have changed."""
    stale_s = float(scenario.communication.stale_s)
    ticks = np.arange(scenario.timing.ticks, dtype=np.int64)
    since_ns = ticks * scenario.timing.dt_ns
    seen = [dead, seconds((ticks - woke) * scenario.timing.dt_ns) <= stale_s]
    seen += [of > stale_s for of in ages.values()]
    seen += [of >= NEVER_RECEIVED_S for of in ages.values()]
    seen += [since_ns >= scenario.uav(uav).joins_ns for uav in scenario.uav_ids]
    seen += [since_ns >= scenario.uav(uav).leaves_ns for uav in scenario.uav_ids]
    changes = [np.flatnonzero(np.diff(part.astype(np.int64))) + 1 for part in seen]
    return np.unique(np.concatenate([[0], *changes]))
