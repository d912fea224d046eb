"""Chains of UAVs that start in place: no error grows along the tree, whatever its depth, the delay and the losses."""

import numpy as np
import pytest

from ptnsbc_sim.scenario import Scenario, load_scenario, scenario_from_text
from ptnsbc_sim.swarm import fly

TF_S = 5.0


def chain(size: int, task: str, **communication: float) -> Scenario:
    """A chain on a zigzag behind a leader on a circle, everybody in place and at rest."""
    offsets = np.array([[-1.6 * k, 1.2 * (k % 2), 0.0] for k in range(size)])
    circle = {"kind": "circle", "centre_m": [0, -4, 5], "radius_m": 4, "rate_rad_s": 0.125}
    starts = offsets + np.array([0.0, 0.0, 5.0])
    changes = {
        "uavs": [{"id": k + 1, "position_m": start.tolist()} for k, start in enumerate(starts)],
        "leader.trajectory": circle,
        "communication.tree": {k: k - 1 for k in range(2, size + 1)},
        "communication.leader_links": list(range(2, size + 1)),
        "communication.estimator_edges": [[k, k + 1] for k in range(2, size)],
        "formation.offsets_m": {k + 1: offsets[k].tolist() for k in range(1, size)},
        "formation.task": task,
        "gains.formation.deadline_s": TF_S,
        "timing.duration_s": 15.0,
    }
    changes |= {f"communication.{key}": value for key, value in communication.items()}
    return load_scenario("paper_5_free", changes)


@pytest.mark.parametrize("task", ["relative_position", "distance_angles", "parent_angle"])
@pytest.mark.parametrize(
    ("size", "links", "most_m"),
    [(8, {}, 0.001), (30, {"delay_s": 0.15, "loss": 0.2}, 0.005)],
    ids=["prompt", "late and lossy"],
)
def test_nobody_in_a_chain_leaves_its_place(
    size: int, task: str, links: dict[str, float], most_m: float
) -> None:
    flown = fly(chain(size, task, **links))
    scenario, places = flown.scenario, flown.truth[:, :, :3]
    offsets = np.array([scenario.offset(uav) for uav in scenario.uav_ids])
    error = np.linalg.norm(places - places[:, :1] - offsets, axis=2)
    assert error[round(TF_S * scenario.timing.control_hz) :].max() < most_m


def test_a_chain_at_rest_that_hears_late_does_not_move() -> None:
    """Before somebody hears of the leader it only guesses where the leader is, and tells nobody."""
    still = {"kind": "line", "position_m": [0, 0, 5]}
    late = chain(8, "relative_position", delay_s=0.15)
    changes = {"leader.trajectory": still, "timing.duration_s": 2.0}
    flown = fly(scenario_from_text(late.text, changes))
    assert np.abs(flown.truth[:, :, :3] - flown.truth[0, :, :3]).max() < 1e-9
