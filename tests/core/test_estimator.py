"""Leader estimator (43)-(48): deadline, steady error with and without feed-forward, stability limit."""

import numpy as np
import pytest
from on_arrays import tuples

from ptnsbc_core import estimator as laws
from ptnsbc_core.topology import Topology, validated_topology
from ptnsbc_core.types import Estimate, EstimatorConfig

DT = 0.01


def estimate_of(numbers: np.ndarray) -> Estimate:
    return Estimate(tuples(numbers[0:3]), tuples(numbers[3:6]), float(numbers[6]))


def vector(estimate: Estimate) -> np.ndarray:
    return np.array([*estimate.position, *estimate.velocity, estimate.yaw])


def disagreement(own: np.ndarray, others: list[np.ndarray]) -> np.ndarray:
    """g_i (7,) of an estimate (7,) and of those that were heard (K, 7)."""
    g = laws.NO_DISAGREEMENT
    for other in others:
        g = laws.add_disagreement(g, estimate_of(own), estimate_of(other))
    return vector(g)


def estimator_step(own: np.ndarray, g: np.ndarray, t: float, dt: float, config) -> np.ndarray:
    return vector(laws.estimator_step(estimate_of(own), estimate_of(g), t, dt, config))


ALL = [2, 3, 4, 5]


def chain(pinned: list[int]) -> Topology:
    edges = [(2, 3), (3, 4), (4, 5)]
    return validated_topology(1, [1, *ALL], {2: 1, 3: 2, 4: 3, 5: 4}, pinned, edges)


def config_of(topology: Topology, uav: int, **changes) -> EstimatorConfig:
    base = EstimatorConfig(1.5, 1e-2, topology.lambda_min, 0.0, 0.0, 1.0, False, False)
    return base._replace(pinned=uav in topology.pinned, **changes)


def estimated(topology: Topology, starts, leader_at, seconds: float, dt: float = DT, **changes):
    """Estimates (4, 7) of the four followers after `seconds`, all updated from the same tick."""
    estimates = np.array(starts, dtype=float)
    for k in range(round(seconds / dt)):
        leader = leader_at(k * dt)
        after = []
        for row, uav in enumerate(ALL):
            config = config_of(topology, uav, **changes)
            others = [estimates[other - 2] for other in topology.neighbours[uav]]
            g = disagreement(estimates[row], others + [leader] * config.pinned)
            after.append(estimator_step(estimates[row], g, k * dt, dt, config))
        estimates = np.array(after)
    return estimates


def still(_: float) -> np.ndarray:
    return np.zeros(7)


@pytest.mark.parametrize("pinned", [ALL, [2]])
def test_networked_error_reaches_the_residual_at_the_deadline(pinned: list[int]) -> None:
    """1/lambda_min makes the slowest mode meet (15); all others are faster."""
    topology = chain(pinned)
    slowest = np.linalg.eigh(topology.matrix)[1][:, 0]
    starts = np.zeros((4, 7))
    starts[:, 0] = 3.0 * slowest
    left = estimated(topology, starts, still, 1.5, dt=1e-3)
    np.testing.assert_allclose(left[:, 0], 3.0 * slowest * 0.01 / 1.01, rtol=1e-3)
    starts[:, 1] = [5.0, -4.0, 3.0, -1.0]
    left = estimated(topology, starts, still, 1.5, dt=1e-3)
    assert np.linalg.norm(left[:, 1]) <= np.linalg.norm(starts[:, 1]) * 0.01 / 1.01 * 1.001


def test_printed_factor_of_45_leaves_a_tenth() -> None:
    topology = chain(ALL)
    slowest = np.linalg.eigh(topology.matrix)[1][:, 0]
    starts = np.zeros((4, 7))
    starts[:, 0] = slowest
    left = estimated(topology, starts, still, 1.5, dt=2e-4, lambda_min=2.0 * topology.lambda_min)
    np.testing.assert_allclose(left[:, 0], slowest * np.sqrt(0.01 / 1.01), rtol=1e-3)


MOVING = {"k1": 4.0, "k2": 2.0, "boundary": 0.5}
SPEED = 0.4


def drifting(t: float) -> np.ndarray:
    return np.array([SPEED * t, 0, 0, SPEED, 0, 0, 0])


def test_saturation_leaves_a_steady_error_in_proportion_to_the_leaders_speed() -> None:
    topology = chain(ALL)
    found = estimated(topology, np.zeros((4, 7)), drifting, 12.0, **MOVING)
    error = found[:, 0] - SPEED * 12.0
    expected = -np.linalg.solve(topology.matrix, np.ones(4)) * SPEED / (4.0 + 2.0 / 0.5)
    np.testing.assert_allclose(error, expected, rtol=1e-3)


def test_estimated_velocity_as_feed_forward_removes_it() -> None:
    topology = chain(ALL)
    found = estimated(topology, np.zeros((4, 7)), drifting, 12.0, feed_forward=True, **MOVING)
    np.testing.assert_allclose(found[:, 0], SPEED * 12.0, atol=1e-9)
    np.testing.assert_allclose(found[:, 3], SPEED, atol=1e-12)


@pytest.mark.parametrize(("share", "grows"), [(0.98, False), (1.02, True)])
def test_stability_limit_of_the_step(share: float, grows: bool) -> None:
    """dt (k1 + k2/width) lambda_max < 2, after the deadline and inside the saturation."""
    topology = chain(ALL)
    k1 = share * 2.0 / (DT * topology.lambda_max) - 2.0 / 0.5
    fastest = np.linalg.eigh(topology.matrix)[1][:, -1]
    estimates = np.zeros((4, 7))
    estimates[:, 0] = 1e-9 * fastest
    config = config_of(topology, 2, k1=k1, k2=2.0, boundary=0.5)
    for _ in range(300):
        after = np.empty_like(estimates)
        for row, uav in enumerate(ALL):
            others = [estimates[other - 2] for other in topology.neighbours[uav]]
            g = disagreement(estimates[row], [*others, np.zeros(7)])
            after[row] = estimator_step(estimates[row], g, 2.0, DT, config)
        estimates = after
    assert bool(np.linalg.norm(estimates[:, 0]) > 1e-9) == grows


def test_disagreement_by_hand() -> None:
    own = np.array([1.0, 2, 3, 0, 0, 0, 3.0])
    other = np.array([0.0, 0, 0, 0, 0, 0, -3.0])
    leader = np.array([1.0, 1, 1, 1, 1, 1, 2.5])
    g = disagreement(own, [other, leader])
    # yaw 3 against -3 differs by 6 - 2 pi, not by 6
    np.testing.assert_allclose(g, [1, 3, 5, -1, -1, -1, 6.0 - 2.0 * np.pi + 0.5])
    np.testing.assert_array_equal(disagreement(own, []), np.zeros(7))


def test_yaw_is_estimated_the_short_way() -> None:
    topology = chain(ALL)
    starts = np.zeros((4, 7))
    starts[:, 6] = 3.0
    found = estimated(topology, starts, lambda _: np.array([0.0] * 6 + [-3.0]), 1.5, dt=1e-3)
    short_way = 2.0 * np.pi - 6.0
    for yaw in found[:, 6]:
        assert abs(yaw) > 3.0 - 1e-9  # over pi, not through zero
        assert abs(abs(yaw + 3.0 + np.pi) % (2 * np.pi) - np.pi) <= short_way * 0.011
