"""The graph: eigenvalues of H by hand, and every way in which a graph cannot carry a formation."""

import numpy as np
import pytest

from ptnsbc_core.errors import TopologyError
from ptnsbc_core.topology import estimator_matrix, validated_topology

TREE = {2: 1, 3: 2, 4: 3, 5: 4}
CHAIN = [(2, 3), (3, 4), (4, 5)]


def chain(followers: int, pinned: list[int]):
    ids = list(range(1, followers + 2))
    tree = {uav: uav - 1 for uav in ids[1:]}
    return validated_topology(1, ids, tree, pinned, [(uav, uav + 1) for uav in ids[1:-1]])


def test_all_followers_pinned_on_a_chain_of_four() -> None:
    topology = chain(4, [2, 3, 4, 5])
    expected = [1.0, 3.0 - np.sqrt(2.0), 3.0, 3.0 + np.sqrt(2.0)]  # 1, 1.586, 3, 4.414
    np.testing.assert_allclose(np.linalg.eigvalsh(topology.matrix), expected, atol=1e-12)
    assert topology.lambda_min == pytest.approx(1.0)
    assert topology.lambda_max == pytest.approx(4.414, abs=1e-3)


@pytest.mark.parametrize(("followers", "least"), [(4, 0.1206), (19, 0.00649)])
def test_only_the_first_pinned(followers: int, least: float) -> None:
    closed = 2.0 - 2.0 * np.cos(np.pi / (2 * followers + 1))
    found = chain(followers, [2]).lambda_min
    assert found == pytest.approx(closed, rel=1e-9)
    assert found == pytest.approx(least, rel=1e-3)


def test_matrix_by_hand() -> None:
    matrix = estimator_matrix([2, 3, 4], frozenset({2}), {2: (3,), 3: (2, 4), 4: (3,)})
    np.testing.assert_array_equal(matrix, [[2, -1, 0], [-1, 2, -1], [0, -1, 1]])


def test_what_a_topology_says() -> None:
    topology = validated_topology(1, [3, 1, 2, 5, 4], {2: 1, 3: 1, 4: 2, 5: 4}, [2, 3, 4, 5], [])
    assert topology.order == (1, 2, 3, 4, 5)
    assert topology.depth == {1: 0, 2: 1, 3: 1, 4: 2, 5: 3}
    assert topology.neighbours == {2: (), 3: (), 4: (), 5: ()}
    np.testing.assert_array_equal(topology.matrix, np.eye(4))


def test_a_leader_alone() -> None:
    topology = validated_topology(7, [7], {}, [], [])
    assert (topology.matrix.shape, topology.lambda_min, topology.depth) == ((0, 0), 1.0, {7: 0})


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"tree": {**TREE, 1: 2}}, "the leader has parent 2"),
        ({"tree": {2: 1, 3: 4, 4: 3, 5: 4}}, "cycle 3 -> 4 -> 3"),
        ({"tree": {2: 1, 3: 2, 5: 4}}, "UAV 4 has no path.*add '4: <parent>'"),
        ({"links": [1]}, "leader_links: 1 is no follower"),
        ({"links": [9]}, "leader_links: 9 is no follower"),
        ({"edges": [(1, 2)]}, r"\[1, 2\] does not join two followers"),
        ({"edges": [(3, 3)]}, r"\[3, 3\] does not join"),
        ({"links": [2], "edges": [(2, 3), (4, 5)]}, "UAV 4 never learns of the leader"),
    ],
)
def test_graphs_that_cannot_carry_a_formation(changed: dict, said: str) -> None:
    given = {
        "leader": 1,
        "uavs": [1, 2, 3, 4, 5],
        "tree": TREE,
        "links": [2, 3, 4, 5],
        "edges": CHAIN,
        **changed,
    }
    with pytest.raises(TopologyError, match=said):
        validated_topology(
            given["leader"], given["uavs"], given["tree"], given["links"], given["edges"]
        )
