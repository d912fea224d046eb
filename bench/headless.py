"""Headless flight: ticks of the whole swarm per second, and what each piece of a tick costs; one core."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from bench.scenarios import grid, paper
from bench.session import Plan, cpu_seconds, take_turns
from bench.table import Row, Target
from ptnsbc_core.kernel import kernel, referred
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.step import step
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.swarm import HeadlessFlight, fly, swarm_of
from ptnsbc_sim.tick import SwarmState, advance_all, inputs_of, sense
from ptnsbc_sim.track import FlightTrack

_SVD = "NumPy 3×3 SVD"
_MATRIX = np.array([[2.0, 0.3, -0.1], [0.2, 1.0, 0.4], [-0.3, 0.1, 0.5]])
_SVD_CALLS = 5000
_TARGETS = {5: 100_000.0, 20: 25_000.0, 100: 300.0}  # of 100: three times real time


@kernel
def _sense(ticks: int, swarm: SwarmState) -> float:
    for tick in range(ticks):
        sense(swarm, tick, None)
    return 0.0


@kernel
def _inputs(ticks: int, swarm: SwarmState) -> float:
    total = 0.0
    for tick in range(ticks):
        for row in range(swarm.bodies.shape[0]):
            inputs = inputs_of(swarm, tick, row, None)
            total += inputs.parent[0] + inputs.leader[0] + inputs.estimates.shape[0]
    return total


@kernel
def _laws(ticks: int, swarm: SwarmState) -> float:
    dt, total = seconds(swarm.wiring.dt_ns), 0.0
    for tick in range(ticks):
        t = seconds(tick * swarm.wiring.dt_ns)
        sense(swarm, tick, None)
        for row in range(swarm.bodies.shape[0]):
            inputs = inputs_of(swarm, tick, row, None)
            swarm.states[row], out = step(swarm.states[row], inputs, t, dt, swarm.configs[row])
            total += out.force[2]
        advance_all(tick, swarm, None)  # by the wrenches as flown: so are the inputs
    return total


@kernel
def _plant(ticks: int, swarm: SwarmState) -> float:
    for tick in range(ticks):
        advance_all(tick, swarm, None)
    return 0.0


_PASSES = {"laws": _laws, "sensing": _sense, "inputs": _inputs, "plant": _plant}


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section."""
    duration_s = plan.of(60.0, 10.0)
    flights = {5: paper(duration_s), 20: grid(20, 100, duration_s)}
    flights[100] = grid(100, 100, plan.of(10.0, 5.0))
    for scenario in (paper(0.1), grid(20, 100, 0.1)):
        fly(scenario)  # compiled or loaded before it counts
    runs = {"svd": lambda: 1e6 * cpu_seconds(lambda: np.linalg.svd(_MATRIX), _SVD_CALLS)}
    for size, scenario in flights.items():
        runs[str(size)] = _ticks_per_s(scenario)
    found = take_turns(runs, plan.of(7, 2))
    rows, svd = [], (_SVD, found["svd"], "µs")
    for size in flights:
        target = Target(_TARGETS[size], at_least=True)
        rows.append(Row(f"headless flight, N = {size}", found[str(size)], "ticks/s", *svd, target))
    for size, scenario in flights.items():
        rows += _pieces(size, scenario, plan.of(7, 2))
    return rows


def _ticks_per_s(scenario: Scenario) -> Callable[[], float]:
    return lambda: scenario.timing.ticks / cpu_seconds(lambda: fly(scenario))


def _pieces(size: int, scenario: Scenario, repeats: int) -> list[Row]:
    """The cost of each piece per UAV and tick, over the whole flight; the others are taken off the pass of the laws."""
    flight = fly(scenario)
    for one in _PASSES.values():
        _pass_ns(one, flight, 1)
    ticks = len(flight.t_ns)
    found = take_turns(
        {name: partial(_pass_ns, one, flight, ticks) for name, one in _PASSES.items()}, repeats
    )
    found["laws"] = [2 * one[0] - sum(one) for one in zip(*found.values(), strict=True)]
    return [
        Row(f"{name} per UAV and tick, N = {size}", values, "ns") for name, values in found.items()
    ]


def _pass_ns(one: Callable[[int, SwarmState], float], flight: HeadlessFlight, ticks: int) -> float:
    """CPU time of one pass per UAV and tick [ns]; it starts as the flight did and changes copies."""
    track = FlightTrack(*(array.copy() for array in flight.track))
    swarm = referred(swarm_of(flight.scenario, flight.swarm.wiring, track, None))
    spent_s = cpu_seconds(lambda: one(ticks, swarm))
    return 1e9 * spent_s / (ticks * len(flight.scenario.uav_ids))
