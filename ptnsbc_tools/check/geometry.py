"""Pre-flight: graph, shape and spacing of the formation."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ptnsbc_core.errors import FormationError
from ptnsbc_core.tasks.registry import conditioning
from ptnsbc_core.types import TASKS
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.build import reference_offset
from ptnsbc_sim.scenario.semantics import STABILITY_LIMIT, estimator_peak, estimator_step
from ptnsbc_tools.check.finding import ERROR, INFO, WARNING, Finding, Findings

SINGULAR = 0.02
"""Smallest singular value [1] of a scaled task below which a formation cannot be held."""


def graph(scenario: Scenario) -> Findings:
    """The tree, and what the leader estimator's graph costs in gain."""
    depth = max(scenario.topology.depth.values())
    yield Finding(
        INFO,
        "communication.tree",
        f"spanning tree, {len(scenario.uav_ids)} UAVs, depth {depth}",
        "rooted at the leader",
        "",
    )
    if not scenario.followers:
        return
    topology = scenario.topology
    peak = estimator_peak(scenario.file) / topology.lambda_min
    step = estimator_step(scenario.file, topology)
    yield Finding(
        WARNING if step > 0.75 * STABILITY_LIMIT else INFO,
        "gains.estimator",
        f"lambda_min(H) {topology.lambda_min:.3g}, peak gain {peak:.3g} 1/s, step {step:.2f}",
        f"step < {STABILITY_LIMIT:g}",
        "more leader_links raise lambda_min and lower the gain",
    )


def _shapeless(scenario: Scenario, uav: int, error: FormationError) -> Finding:
    key = f"formation.offsets_m.{uav}"
    text = str(error).removeprefix(f"{scenario.source}: {key}: ")
    value, _, rest = text.partition(": expected ")
    limit, _, advice = rest.partition("; ")
    return Finding(ERROR, key, value, limit, advice)


def shape(scenario: Scenario) -> Findings:
    """Conditioning of every follower's task at the desired formation."""
    task = scenario.file.formation.task
    threshold = scenario.gains.damping.threshold
    for uav in scenario.followers:
        parent = scenario.parent(uav)
        assert parent is not None  # or the scenario would not have loaded
        try:
            row_scale = agent_config(scenario, uav).row_scale
        except FormationError as error:
            yield _shapeless(scenario, uav, error)
            continue
        sigma = conditioning(
            TASKS[task],
            scenario.offset(uav),
            scenario.offset(parent),
            reference_offset(scenario, uav),
            row_scale,
        )
        singular = not sigma >= SINGULAR  # also when it is no number
        severity = ERROR if singular else WARNING if sigma < threshold else INFO
        yield Finding(
            severity,
            f"formation.offsets_m.{uav}",
            f"sigma_min of task {task} {sigma:.3f}",
            f">= {SINGULAR if singular else threshold:g}"
            + ("" if singular else " or it is damped"),
            ""
            if severity == INFO
            else f"move UAV {uav} off the singular shape (for distance_angles a right angle at the "
            "reference), or use formation.task: parent_angle or relative_position",
        )


def spacing(scenario: Scenario) -> Findings:
    """Desired positions and starts against the keep-out distance between UAVs."""
    keep_out = scenario.uav_keep_out_m + scenario.gains.clearance.margin_m
    places = {
        "formation.offsets_m": {uav: scenario.offset(uav) for uav in scenario.uav_ids},
        "uavs position_m": {uav: scenario.uav(uav).position for uav in scenario.uav_ids},
    }
    for key, where in places.items():
        distances = {
            (a, b): float(np.linalg.norm(where[a] - where[b]))
            for a, b in combinations(scenario.uav_ids, 2)
        }
        near = {pair: d for pair, d in distances.items() if d < keep_out}
        closest = min(distances, key=lambda pair: distances[pair], default=None)
        for (a, b), distance in (
            near or ({closest: distances[closest]} if closest else {})
        ).items():
            yield Finding(
                ERROR if distance < keep_out else INFO,
                key,
                f"UAV {a} and UAV {b} {distance:.2f} m apart",
                f">= {keep_out:g} m",
                "move them apart, or lower formation.uav_keep_out_m" if near else "",
            )


def starts_clear(scenario: Scenario) -> Findings:
    """Starts against the keep-outs of obstacles."""
    for index, uav in enumerate(scenario.uav_ids):
        for obstacle in scenario.obstacles:
            distance = float(np.linalg.norm(scenario.uav(uav).position - obstacle.position))
            if distance < obstacle.keep_out_m:
                yield Finding(
                    ERROR,
                    f"uavs[{index}].position_m",
                    f"UAV {uav} starts {distance:.2f} m from {obstacle.name}",
                    f">= {obstacle.keep_out_m:g} m",
                    "start it outside, or lower the obstacle's keep_out_m",
                )
