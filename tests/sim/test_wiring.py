"""Flights of UAVs with several parents."""

import numpy as np
import pytest

from ptnsbc_sim.scenario import Scenario, ScenarioError, load_scenario
from ptnsbc_sim.swarm import HeadlessFlight, fly
from ptnsbc_sim.wiring import wiring_of

SIZE, TF_S = 10, 5.0
STRUCK = 3


def ladder(weight: float | None, **changes: object) -> Scenario:
    """A chain on a zigzag in place; with a weight every UAV follows also the one before its parent."""
    offsets = np.array([[-1.6 * k, 1.2 * (k % 2), 0.0] for k in range(SIZE)])
    parents = (
        {k: {k - 1: 1.0 - weight, k - 2: weight} for k in range(3, SIZE + 1)} if weight else None
    )
    keys: dict[str, object] = {
        "uavs": [
            {"id": k + 1, "position_m": start.tolist()}
            for k, start in enumerate(offsets + np.array([0.0, 0.0, 5.0]))
        ],
        "leader.trajectory": {
            "kind": "circle",
            "centre_m": [0, -4, 5],
            "radius_m": 4,
            "rate_rad_s": 0.125,
        },
        "communication.tree": {k: k - 1 for k in range(2, SIZE + 1)},
        "communication.parents": parents,
        "communication.leader_links": list(range(2, SIZE + 1)),
        "communication.estimator_edges": [[k, k + 1] for k in range(2, SIZE)],
        "formation.offsets_m": {k + 1: offsets[k].tolist() for k in range(1, SIZE)},
        "formation.task": "relative_position",
        "gains.formation.deadline_s": TF_S,
        "timing.duration_s": 15.0,
    }
    return load_scenario("paper_5_free", {**keys, **changes})


def errors(flown: HeadlessFlight) -> np.ndarray:
    """Deviations (T, N, 3) [m] from the slots beside the leader."""
    scenario, places = flown.scenario, flown.truth[:, :, :3]
    offsets = np.array([scenario.offset(uav) for uav in scenario.uav_ids])
    return places - places[:, :1] - offsets


def test_links_that_are_late_and_lossy_move_nobody_from_its_place() -> None:
    lossy = {"communication.delay_s": 0.15, "communication.loss": 0.2}
    found = errors(fly(ladder(0.5, **lossy)))
    assert np.linalg.norm(found[round(TF_S * 100) :], axis=2).max() < 0.005


@pytest.mark.parametrize("weight", [0.3, 0.5])
def test_a_child_takes_over_by_weight_what_its_parent_deviates(weight: float) -> None:
    """One UAV is pushed; against the chain its child has the share of its weight, and so has the next one."""
    uavs = [one.model_dump(mode="json", exclude_unset=True) for one in ladder(None).uavs]
    uavs[STRUCK - 1]["disturbance_m_s2"] = [0, 0, "4 sin"]
    shares = []
    for one in (ladder(None, uavs=uavs), ladder(weight, uavs=uavs)):
        pushed = np.ptp(errors(fly(one))[-700:, STRUCK - 1 : STRUCK + 2, 2], axis=0)
        shares.append(pushed[1:] / pushed[0])
    np.testing.assert_allclose(shares[0][1], 0.5 * shares[0][0], rtol=0.05)
    expected = np.array([1.0 - weight, weight + 0.5 * (1.0 - weight) ** 2]) * shares[0][0]
    np.testing.assert_allclose(shares[1], expected, rtol=0.05)


def test_a_uav_with_another_parent_goes_on_when_one_is_killed() -> None:
    kill = {"kind": "kill", "uav": STRUCK, "at_s": 8.0}
    one, two = (
        np.linalg.norm(errors(fly(ladder(weight, faults=[kill])))[-1, STRUCK:], axis=1)
        for weight in (None, 0.5)
    )
    assert one[0] > 1.0, "it holds, and those behind it follow it"
    assert two.max() < 0.05


def test_who_has_one_parent_costs_nothing() -> None:
    wiring = wiring_of(load_scenario("paper_5"))
    assert not wiring.parents.several.any()
    assert wiring_of(ladder(0.5)).parents.several.tolist() == [0, 0, *[2] * (SIZE - 2)]


@pytest.mark.parametrize(
    ("parents", "keys", "text"),
    [
        (
            {4: {2: 0.5, 1: 0.5}},
            {},
            "communication.parents.4: [2, 1]: expected 3, its parent in the tree",
        ),
        ({4: {3: 0.5, 9: 0.5}}, {}, "communication.parents.4.9: 9: no such UAV"),
        ({4: {3: 0.5, 2: 0.4}}, {}, "communication.parents.4: weights sum to 0.9: expected 1"),
        ({4: {3: 0.5, 2: -0.5}}, {}, "communication.parents.4.2"),
        ({1: {2: 1.0}}, {}, "communication.parents.1: [2]: expected a follower"),
        ({3: {2: 0.5, 5: 0.5}}, {}, "communication.parents: cycle 3 -> 5 -> 4 -> 3"),
        ({4: {3: 0.5, 2: 0.5}}, {"formation.task": "parent_angle"}, "relative_position"),
        ({4: {3: 0.5, 2: 0.5}}, {"formation.frame": "heading"}, "a shape that does not move"),
        (
            {4: {3: 0.5, 2: 0.5}},
            {"formation.assignment": "optimal"},
            "assignment: optimal: expected fixed beside",
        ),
        (
            {4: {3: 0.5, 2: 0.5}},
            {"formation.vacancy": "keep"},
            "vacancy: keep: expected wait beside",
        ),
        ({4: {3: 0.5, 2: 0.5}}, {"formation.sight_m": 0.2}, "sight_m: 0.2: expected 0 beside"),
    ],
)
def test_parents_that_do_not_fit_are_refused(parents, keys, text) -> None:
    given = {"communication.parents": parents, "formation.task": "relative_position", **keys}
    with pytest.raises(ScenarioError) as error:
        load_scenario("paper_5_free", given)
    assert text in str(error.value)
