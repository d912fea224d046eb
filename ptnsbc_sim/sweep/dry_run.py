"""Dry runs: a scenario flown as it stands and perturbed, before anything arms.

The first flight starts where the scenario says; the others start beside that, and links that lose or delay messages are
worse than the scenario says. Every flight has a seed of its own for noise, gusts and losses. The same scenario, number
of flights and seed give the same dry runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario, scenario_from_text
from ptnsbc_sim.scenario.approach.deadline import turn_of
from ptnsbc_sim.swarm import HeadlessFlight
from ptnsbc_sim.sweep.draws import NEAR, UNIFORM, Starts, SweepAxis
from ptnsbc_sim.sweep.plan import SweepPlan, draw
from ptnsbc_sim.sweep.rows import SweepRow, fly_draw
from ptnsbc_sim.verdict.deadline import KEPT, MET_LATE, WORST_FIRST

LEAST = 0.5
"""Share of flights that must be met, the first one among them."""
LEAST_BY_CHANCE = 0.95
"""The same where noise, gusts, faults or links differ from flight to flight: the flight itself is one of them."""
ACCEPTED, REFUSED = "accepted", "refused"
START_M = 0.02
"""Standard deviation of a perturbed start, per axis."""
AFTER_S = 10.0
"""Perturbed flights end so long after the deadline, or with the scenario."""

_LEAST_AFTER_S = 2.0  # a scenario that ends earlier is flown for so long
_EXACT = 1e-9
_MORE_LOSS = 0.05
_MORE_DELAY_S = 0.02
_TRIALS = 4  # perturbed flights of a remedy
_LONGER = (1.25, 1.6, 2.0, 3.0)
_HALVINGS = 3

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class DryFlight:
    """One flight of a dry run: its verdict, its worst UAV, and how close UAVs came."""

    verdict: str
    uav: int
    cause: str  # why not met, empty when met
    # largest after the deadline, excused spans included; None: none, or not finite
    error_m: float | None
    room_m: float | None  # smallest distance less its keep-out; None: nothing to keep out of
    late: tuple[SweepRow, ...] = ()  # the UAVs that gave way, and came within the promise
    in_place: int = 0  # UAVs at the chosen deadline

    @property
    def met(self) -> bool:
        """True if all UAVs kept their promise, those that gave way later, and their distances."""
        return self.verdict in KEPT


@dataclass(frozen=True)
class DryRun:
    """The flights of a dry run, the unperturbed one first."""

    flights: tuple[DryFlight, ...]
    least: float = LEAST  # share of them that must be met

    @property
    def met(self) -> int:
        """The number of those that are met."""
        return sum(flight.met for flight in self.flights)

    def accepted(self) -> bool:
        """True if the unperturbed flight is met, and at least the share `least` of all."""
        return self.flights[0].met and self.met >= self.least * len(self.flights) - _EXACT

    @property
    def worst(self) -> DryFlight:
        """The flight to look at: the worst verdict, and of these the least room, then the largest error."""

        def rank(flight: DryFlight) -> tuple[int, float, float]:
            room = math.inf if flight.room_m is None else flight.room_m
            error = math.inf if flight.error_m is None else flight.error_m
            return WORST_FIRST.index(flight.verdict), room, -error

        return min(self.flights, key=rank)

    @property
    def least_room_m(self) -> float | None:
        """The smallest distance less its keep-out, in all flights."""
        rooms = [flight.room_m for flight in self.flights if flight.room_m is not None]
        return min(rooms, default=None)


def dry_run(
    scenario: Scenario, runs: int, seed: int = 0, progress: Progress | None = None
) -> DryRun:
    """Fly a scenario as it stands, and `runs` times perturbed; SweepError when no perturbed start has room."""
    found = []
    for flight in _flights(scenario, runs, seed):
        found.append(flight)
        if progress is not None:
            progress(len(found), runs + 1)
    return DryRun(tuple(found), least_share(scenario))


def least_share(scenario: Scenario) -> float:
    """Share of the dry flights of a scenario that must be met."""
    return LEAST_BY_CHANCE if scenario.imperfect else LEAST


def accepts(scenario: Scenario, runs: int, seed: int = 0, least: float | None = None) -> bool:
    """The answer of `dry_run(…).accepted()`; no flight is flown that cannot change it. `least`: another share."""
    least, met = least_share(scenario) if least is None else least, 0
    needed = math.ceil(least * (runs + 1) - _EXACT)
    for flown, flight in enumerate(_flights(scenario, runs, seed), start=1):
        met += flight.met
        if met >= needed or not met or met + runs + 1 - flown < needed:
            break
    return met >= needed


def dry_run_says(plan: SweepPlan, k: int) -> str:
    """`accepted` or `refused`: the dry run of draw k of a sweep, whose seeds are not those of the flight."""
    return ACCEPTED if accepts(draw(plan, k), plan.check, plan.seed) else REFUSED


def _flights(scenario: Scenario, runs: int, seed: int) -> Iterator[DryFlight]:
    deadline_s = scenario.gains.formation.deadline_s
    # The fleet computes the turn from the starts of the file, wherever its UAVs stand.
    changes = {"formation.turn_rad": turn_of(scenario)}
    if scenario.timing.duration_s < deadline_s + _LEAST_AFTER_S:  # nothing could be judged
        changes["timing.duration_s"] = deadline_s + _LEAST_AFTER_S
    text = scenario_from_text(scenario.text, changes, source=scenario.source).text
    as_it_stands = SweepPlan(text, 1, seed, source=scenario.source)
    perturbed = SweepPlan(
        text,
        runs,
        seed + 1,
        axes=tuple(_worse_links(scenario)),
        starts=Starts(NEAR, (START_M,)),
        stop_after_s=deadline_s + AFTER_S,
        source=scenario.source,
    )
    room: HeadlessFlight | None = None
    for plan in (as_it_stands, perturbed):
        for k in range(plan.draws if plan.runs else 0):
            rows, _, room = fly_draw(plan, k, room)
            yield _judged(scenario, rows)


def _worse_links(scenario: Scenario) -> Iterator[SweepAxis]:
    """Links that lose or delay messages do it more than the scenario says."""
    block = scenario.communication
    for key, value, more in (
        ("loss", block.loss, min(_MORE_LOSS, 1.0 - block.loss)),
        ("delay_s", block.delay_s, min(_MORE_DELAY_S, 0.5 * (block.stale_s - block.delay_s))),
    ):
        if value > 0.0:
            yield SweepAxis(f"communication.{key}", UNIFORM, (value, value + more))


def _judged(scenario: Scenario, rows: list[SweepRow]) -> DryFlight:
    def rank(row: SweepRow) -> tuple[int, float]:
        error = _finite(row.largest_after_all_m)
        return WORST_FIRST.index(row.verdict), -(math.inf if error is None else error)

    worst = min(rows, key=rank)
    rooms = [
        row.closest_uav_m
        - max(scenario.keep_out_between(row.uav, one) for one in scenario.uav_ids if one != row.uav)
        for row in rows
        if row.closest_uav_m is not None
    ]
    rooms += [row.closest_obstacle_m for row in rows if row.closest_obstacle_m is not None]
    return DryFlight(
        verdict=rows[0].flight_verdict,
        uav=worst.uav,
        cause=worst.cause,
        error_m=_finite(worst.largest_after_all_m),
        room_m=min(rooms, default=None),
        late=tuple(row for row in rows if row.verdict == MET_LATE),
        in_place=sum(row.in_place is True for row in rows),
    )


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def with_starts_at(scenario: Scenario, positions: Mapping[int, tuple[float, ...]]) -> Scenario:
    """The scenario with UAVs at measured positions (3,) [m], ENU, by id."""
    keys: dict[str, Any] = {
        f"uavs[{index}].position_m": [float(number) for number in positions[uav]]
        for index, uav in enumerate(scenario.uav_ids)
        if uav in positions
    }
    if not keys:
        return scenario
    keys["formation.turn_rad"] = turn_of(scenario)  # from the starts of the file
    return scenario_from_text(scenario.text, keys, source=scenario.source)


@dataclass(frozen=True)
class Remedy:
    """A change of a scenario under which every flight of a small dry run was met."""

    changes: Mapping[str, Any]  # dotted keys
    said: str  # the change in words


def remedies(scenario: Scenario, seed: int = 0) -> Iterator[Remedy]:
    """The changes that mend a scenario, each flown: the shortest deadline, task, graph, avoidance."""
    longer = _shortest_deadline(scenario, seed)
    if longer is not None:
        yield longer
    for changes, said in _candidates(scenario):
        if _mends(scenario, changes, seed):
            yield Remedy(changes, said)


def _candidates(scenario: Scenario) -> Iterator[tuple[dict[str, Any], str]]:
    formation, tree = scenario.formation, scenario.communication.tree
    if getattr(formation, "assignment", "") == "fixed":
        yield {"formation.assignment": "optimal"}, "set formation.assignment to optimal"
    if formation.task != "relative_position":
        yield {"formation.task": "relative_position"}, "set formation.task to relative_position"
    leader = scenario.leader.id
    if formation.task == "relative_position" and set(tree.values()) != {leader} and tree:
        star = {
            "communication.tree": dict.fromkeys(scenario.followers, leader),
            "communication.leader_links": list(scenario.followers),
        }
        yield star, "let every UAV follow the leader (communication.tree)"
    if formation.avoidance == "off":
        yield {"formation.avoidance": "set_based"}, "set formation.avoidance to set_based"


def _longer(scenario: Scenario, deadline_s: float) -> dict[str, Any]:
    added_s = deadline_s - scenario.gains.formation.deadline_s
    return {
        "gains.formation.deadline_s": deadline_s,
        "timing.duration_s": scenario.timing.duration_s + added_s,
    }


def _shortest_deadline(scenario: Scenario, seed: int) -> Remedy | None:
    """The shortest deadline above the present one that flies, to a few percent."""
    low = scenario.gains.formation.deadline_s
    longer = (_to_hundredths(low * k) for k in _LONGER)
    high = next((one for one in longer if _mends(scenario, _longer(scenario, one), seed)), None)
    if high is None:
        return None
    for _ in range(_HALVINGS):
        middle = _to_hundredths(0.5 * (low + high))
        if _mends(scenario, _longer(scenario, middle), seed):
            high = middle
        else:
            low = middle
    said = f"set gains.formation.deadline_s to at least {high:.2f} s"
    return Remedy(_longer(scenario, high), said)


def _to_hundredths(deadline_s: float) -> float:
    """A deadline as it is printed: what is said has been flown."""
    return math.ceil(100.0 * deadline_s) / 100.0


def _mends(scenario: Scenario, changes: Mapping[str, Any], seed: int) -> bool:
    try:
        changed = scenario_from_text(scenario.text, changes, source=scenario.source)
        return accepts(changed, _TRIALS, seed, least=1.0)
    except PtnsbcError:  # a change that this scenario does not allow
        return False
