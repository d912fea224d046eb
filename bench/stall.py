"""The distance of a simulated UAV from its path, when a busy computer gives it no setpoint for a moment.

`python -m bench.stall [--runs 200] [--hz 50] [--seed 1]` flies a leader in the sim's real time, on a clock of its own:
in half of the flights it hovers, in the others it flies a circle at 2.4 m/s. Once in a flight its wrenches, or the
sim as well, stand still for 0.06 to 0.25 s. Shortly before, its position jumps by 7 cm, so that it is turning. Each
flight is flown again by a sim that holds the last wrench. Printed are quantiles of the largest distance from the path.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from bench.scenarios import grid
from bench.session import print_progress
from ptnsbc_core.curves.trajectory import reference_positions
from ptnsbc_core.types import MODE_FORMATION, Array
from ptnsbc_io.wire import Stamped
from ptnsbc_nodes.comm.graph import Senders
from ptnsbc_nodes.sim.real_time import RealTimeWorld
from ptnsbc_nodes.uav.controller import StepTime, UavController
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.build import leader_trajectory
from ptnsbc_sim.world import World

_LEADER = 1
_DURATION_S = 12.0
_SETTLED_S = 6.0
_JUMP_M = 0.07
_CIRCLE = {"kind": "circle", "centre_m": [0, 0, 3], "radius_m": 4.0, "rate_rad_s": 0.6}
_PATHS = {"hover": {}, "circle": {"leader.trajectory": _CIRCLE}}


class Holding(World):
    """Vehicles that hold the last wrench, however late the next one is."""

    def with_late_setpoint(self, uav_id: int, wrench: Array) -> Array:
        """The same wrench (6,)."""
        return wrench


class Stall(NamedTuple):
    """One moment without setpoints, in control periods."""

    begin: int
    periods: int
    sim_as_well: bool
    jump: Array  # (3,) [m] of the measured position, for the second that ends
    before: int  # so many periods before the stall


def drawn(chance: Generator, hz: int) -> Stall:
    """A stall by chance."""
    jump = chance.normal(size=3)
    return Stall(
        round(chance.uniform(7.0, 9.0) * hz),
        round(chance.uniform(0.06, 0.25) * hz),
        bool(chance.integers(2)),
        _JUMP_M * jump / np.linalg.norm(jump),
        round(chance.uniform(0.02, 0.4) * hz),
    )


def off_m(scenario: Scenario, stall: Stall, kind: type[World]) -> float:
    """Largest distance [m] of the leader from its path."""
    world, path = kind(scenario), leader_trajectory(scenario)
    nobody: Any = SimpleNamespace(publish=lambda _now_ns: None)
    real_time = RealTimeWorld(scenario, world, nobody)
    uav = UavController(agent_config(scenario, _LEADER), Senders(None, None, ()))
    last, largest = -1, 0.0
    for tick in range(round(_DURATION_S * scenario.control_hz)):
        now_ns = tick * scenario.dt_ns
        stalled = stall.begin <= tick < stall.begin + stall.periods
        if stalled and stall.sim_as_well:
            continue
        real_time.tick(now_ns)
        if tick > _SETTLED_S * scenario.control_hz:
            place = reference_positions(path, np.array([now_ns * 1e-9]))[0]
            largest = max(largest, float(np.linalg.norm(world.truth(_LEADER)[0:3] - place)))
        if stalled:
            continue
        odometry = world.odometry(_LEADER).copy()
        if 0 < stall.begin - stall.before - tick <= scenario.control_hz:
            odometry[0:3] += stall.jump
        uav.inbox.own = Stamped(now_ns, odometry)
        uav.inbox.near = Stamped(now_ns, np.zeros((0, 7)))
        elapsed_ns = (tick - last) * scenario.dt_ns
        at = StepTime(now_ns, elapsed_ns, MODE_FORMATION, 0, 0, True)
        wrench = uav.step(at, NO_CUTOFF_NS).wrench.copy()
        real_time.on_wrench(_LEADER, Stamped(now_ns, wrench), now_ns)
        last = tick
    return largest


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="bench.stall", description=__doc__)
    parser.add_argument("--runs", type=int, default=200, help="flights along each path")
    parser.add_argument("--hz", type=int, default=50, help="control periods per second")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(argv)
    quantiles = {"median": 0.5, "nine of ten within": 0.9, "largest": 1.0}
    print(f"| path | the late vehicle | {' | '.join(f'{name} [m]' for name in quantiles)} |")
    print("|---|---|---|---|---|")
    for path, keys in _PATHS.items():
        scenario = grid(2, options.hz, _DURATION_S).with_({"formation.avoidance": "off", **keys})
        chance = np.random.default_rng(options.seed)
        stalls = [drawn(chance, options.hz) for _ in range(options.runs)]
        for name, kind in (("keeps its attitude", World), ("holds its wrench", Holding)):
            print_progress(f"stall: {path}, {name}")
            found = [off_m(scenario, stall, kind) for stall in stalls]
            figures = [f"{np.quantile(found, share):.3f}" for share in quantiles.values()]
            print(f"| {path} | {name} | {' | '.join(figures)} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
