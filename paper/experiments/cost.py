"""Computing time and received messages of one UAV, with more and more UAVs in the formation."""

from __future__ import annotations

import math
import time
from typing import Any, NamedTuple

import numpy as np
import yaml

from paper.claims import FAILS, HOLDS
from paper.experiment_result import Claim, Column, ExperimentResult, Table
from paper.output import ExperimentFolder
from ptnsbc_core.agent import Agent
from ptnsbc_core.types import MODE_FORMATION, AgentInputs
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_sim.scenario import Scenario, agent_config, load_scenario, scenario_from_text
from ptnsbc_sim.world import World

SIZES = (5, 10, 20, 50)
_SPACING_M = 2.0
_RANGE_M = 1.5  # no UAV is in range: near objects cost per object, not per UAV of the swarm
_CALLS, _ROUNDS, _SAMPLED = 1000, 7, 5
_SAME = 1.25  # largest ratio of two times that count as the same: other programs run too
_T_S = 2.0
# With one link into a deep tree H is nearly singular, and the gain Xi / lambda_min has to stay small.
_SLOW = {"deadline_s": 60, "residual": 0.1, "k1_1_s": 5, "k2": 3.5, "boundary": 1.2}


class TickLoad(NamedTuple):
    """Messages between UAVs in one tick, of the busiest follower and of the leader."""

    received: int  # from other UAVs
    sent: int  # one for each reader
    sent_by_leader: int
    lambda_min: float


def binary_tree(size: int, timing: dict[str, Any], sensor: dict[str, Any]) -> dict[str, Any]:
    """A scenario of `size` UAVs 2 m apart around a hovering leader; UAV i forms up on i // 2 and hears the leader."""
    followers = range(2, size + 1)
    columns = math.ceil(math.sqrt(size))
    places = [[-_SPACING_M * (k // columns), _SPACING_M * (k % columns), 0.0] for k in range(size)]
    return {
        "name": f"tree_{size}",
        "timing": timing,
        "sensor": sensor,
        "plant": yaml.safe_load(load_scenario("paper_5").text)["plant"],
        "communication": {
            "tree": {i: i // 2 for i in followers},
            "leader_links": list(followers),
            "estimator_edges": [[i // 2, i] for i in followers if i // 2 != 1],
        },
        "leader": {"id": 1, "trajectory": {"kind": "line", "position_m": [0, 0, 3]}},
        "formation": {
            "task": "relative_position",
            "offsets_m": {i: places[i - 1] for i in followers},
            "uav_keep_out_m": 0.5,
        },
        "uavs": [{"id": k + 1, "position_m": [x, y, 3.0]} for k, (x, y, _) in enumerate(places)],
    }


def tree(size: int, *, all_linked: bool = True) -> Scenario:
    """A tree of UAVs; all of them, or the children of the leader alone, have a leader link."""
    timing = {"control_hz": 100, "physics_hz": 500, "duration_s": 5}
    file = binary_tree(size, timing, {"range_m": _RANGE_M, "rate_hz": 10})
    file["gains"] = {"formation": {"deadline_s": 5}, "estimator": _SLOW}
    if not all_linked:
        links = file["communication"]
        links["leader_links"] = [i for i in links["leader_links"] if i // 2 == 1]
    return scenario_from_text(yaml.safe_dump(file), source=f"tree of {size}")


def tick_load(scenario: Scenario) -> TickLoad:
    """Messages per tick, from the graph by which the processes subscribe."""
    edges = CommunicationGraph(scenario, FlightOptions())
    received = [
        len(edges.senders(uav).states) + len(edges.senders(uav).estimators)
        for uav in scenario.followers
    ]
    sent = {
        u: edges.readers(topics.formation_state(u)) + edges.readers(topics.leader_estimate(u))
        for u in scenario.uav_ids
    }
    by_leader = sent.pop(scenario.leader.id)
    return TickLoad(
        max(received), max(sent.values()), by_leader, float(scenario.topology.lambda_min)
    )


def follower_inputs(scenario: Scenario, world: World, uav: int) -> AgentInputs:
    """The inputs of a follower in flight: parent, leader, neighbours' estimates, near objects."""
    parent, age_s = scenario.communication.parent(uav), scenario.timing.dt_ns * 1e-9
    leader = world.odometry(scenario.leader.id)
    neighbours = scenario.topology.neighbours.get(uav, ())
    return AgentInputs(
        own=world.odometry(uav).copy(),
        parent=world.odometry(scenario.leader.id if parent is None else parent).copy(),
        parent_age_s=age_s,
        leader=leader.copy(),
        leader_age_s=age_s,
        estimates=np.tile(leader, (len(neighbours), 1)),
        estimate_age_s=np.full(len(neighbours), age_s),
        near=world.near(uav),
        near_age_s=0.0,
        mode=MODE_FORMATION,
        start_age_s=_T_S,
    )


def _followers(scenario: Scenario) -> list[tuple[Agent, AgentInputs]]:
    """The deepest followers, each with what it knows."""
    world = World(scenario)
    found = []
    for uav in scenario.followers[-_SAMPLED:]:
        known = follower_inputs(scenario, world, uav)
        found.append((Agent(agent_config(scenario, uav), known.own), known))
    return found


def _step_us(followers: list[tuple[Agent, AgentInputs]]) -> float:
    """Time of one control step [µs], mean over the followers."""
    found = []
    for agent, known in followers:
        started = time.perf_counter()
        for _ in range(_CALLS):
            agent.step(known, _T_S, 0.01)
        found.append((time.perf_counter() - started) / _CALLS)
    return 1e6 * sum(found) / len(found)


def step_times(scenarios: dict[int, Scenario]) -> dict[int, float]:
    """Time of a control step [µs] by size: the best of rounds that take turns."""
    followers = {size: _followers(one) for size, one in scenarios.items()}
    rounds = [{size: _step_us(some) for size, some in followers.items()} for _ in range(_ROUNDS)]
    return {size: min(one[size] for one in rounds) for size in scenarios}


def cost_claim(loads: dict[int, TickLoad], times: dict[int, float]) -> Claim:
    """A UAV computes and receives the same, whatever the size of the formation is."""
    sizes = sorted(loads)
    least, large, most = sizes[0], sizes[-2], sizes[-1]
    # The smallest tree has no UAV with two children below the leader's; from the next on all are alike.
    same = times[most] / times[least] < _SAME and loads[most][:2] == loads[large][:2]
    return Claim(
        "cost",
        "More UAVs cost a UAV neither computation nor communication",
        "independent of N",
        f"control step {times[least]:.1f} µs at N = {least}, {times[most]:.1f} µs at N = {most}; a follower hears "
        f"{loads[least].received} and {loads[most].received} messages per tick and sends {loads[least].sent} and "
        f"{loads[most].sent}; the leader is heard by "
        f"{loads[least].sent_by_leader} and {loads[most].sent_by_leader}",
        f"{HOLDS} when the leader's readers are not counted" if same else FAILS,
        "table *cost*",
    )


def run(output: ExperimentFolder) -> ExperimentResult:
    """Measure the control step and count messages for every size."""
    scenarios = {size: tree(size) for size in SIZES}
    loads = {size: tick_load(one) for size, one in scenarios.items()}
    sparse = {size: tick_load(tree(size, all_linked=False)) for size in SIZES}
    output.progress("measuring the control step")
    times = step_times(scenarios)
    rows = tuple((size, times[size], *loads[size], *sparse[size]) for size in SIZES)
    table = Table(
        "cost",
        "One UAV among N: a binary tree, follower i forms up on i // 2",
        (
            Column("N"),
            Column("control step, µs", 1),
            *(
                Column(f"{what}, {linked} linked", digits)
                for linked in ("all", "children")
                for what, digits in (
                    ("heard per tick", 2),
                    ("sent per tick", 2),
                    ("readers of the leader", 2),
                    ("λmin(H)", 4),
                )
            ),
        ),
        rows,
        "A follower's work does not depend on N. Where everybody hears the leader, as in (53), its one "
        "message has N − 1 readers; where only its children do, λmin(H) falls with N instead, and the estimator needs "
        "that much more gain or time.",
    )
    return ExperimentResult(
        "cost",
        "Cost of one UAV",
        "Time of `Agent.step` from Python, best of seven rounds; messages of the busiest follower counted in the graph "
        "by which the processes subscribe. Nobody is in the range of a near-object sensor here: those cost per object.",
        tables=(table,),
        claims=(cost_claim(loads, times),),
        timed=True,
    )
