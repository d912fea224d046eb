"""Trees proposed for a shape."""

from typing import Any

import numpy as np
import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.tasks.formation_tasks import conditioning
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.scenario.constants import reference_offset
from ptnsbc_sim.scenario.fields import LARGEST
from ptnsbc_sim.scenario.mission.completion import proposed_tree
from ptnsbc_sim.scenario.mission.shapes import ShapeBlock, named_places

ANCHOR = np.array([2.0, 0.0, 0.0])


def places(kind: str, size: int) -> dict[int, np.ndarray]:
    block = ShapeBlock.model_validate({"kind": kind, "spacing_m": 1.5})
    return dict(enumerate(named_places(block, size), 1))


def depth(tree: dict[int, int], uav: int) -> int:
    return 0 if uav == 1 else 1 + depth(tree, tree[uav])


@pytest.mark.parametrize("kind", ["v", "line", "column", "grid", "circle", "sphere"])
@pytest.mark.parametrize("size", [2, 7, 20])
def test_tree_reaches_everybody_within_three_hops(kind: str, size: int) -> None:
    tree = proposed_tree(places(kind, size), 1, "relative_position", ANCHOR)
    assert set(tree) == set(range(2, size + 1))
    assert max(depth(tree, uav) for uav in tree) <= 3


def test_a_v_of_seven_hangs_on_its_arms() -> None:
    assert proposed_tree(places("v", 7), 1, "relative_position", ANCHOR) == {
        2: 1, 3: 1, 4: 2, 5: 3, 6: 4, 7: 5,
    }  # fmt: skip


def test_edges_of_angle_tasks_are_well_conditioned() -> None:
    changes = {"communication.tree": "auto", "formation.task": "distance_angles"}
    scenario = load_scenario("paper_20", changes)
    for uav in scenario.followers:
        parent = scenario.communication.parent(uav)
        assert parent is not None
        config = agent_config(scenario, uav)
        reference = reference_offset(scenario, uav)
        own, above = scenario.offset(uav), scenario.offset(parent)
        task = TASKS["distance_angles"]
        assert conditioning(task, own, above, reference, config.row_scale) >= 0.35


def test_without_a_parent_the_shape_is_refused() -> None:
    """Straight above the leader no angle has a meaning."""
    changes = {
        "communication.tree": "auto",
        "formation.offsets_m": {k: [0, 0, float(k)] for k in (2, 3, 4, 5)},
    }
    with pytest.raises(PtnsbcError, match=r"tree: auto: no well conditioned parent for UAV 2"):
        load_scenario("paper_5", changes)
    found = load_scenario("paper_5", {**changes, "formation.task": "relative_position"})
    assert set(found.communication.tree) == {2, 3, 4, 5}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"formation.task": ["x"]}, r"formation\.task"),
        ({"formation.heading_anchor_m": ["a", 1, 2]}, r"formation\.heading_anchor_m\[0\]"),
        ({"leader.id": 99}, r"leader\.id: 99"),
        ({"leader.id": [1]}, r"leader\.id"),
        ({"uavs": []}, r"uavs"),
    ],
)
def test_what_is_malformed_is_named_and_not_the_tree(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(PtnsbcError, match=words):
        load_scenario("paper_5", {"communication.tree": "auto", **changes})


@pytest.mark.parametrize("size", [1e12, 1e308])
def test_places_beyond_all_measure_are_no_traceback(size: float) -> None:
    far = {k: [size, float(k), 0] for k in (2, 3, 4, 5)}
    line = {"kind": "line", "spacing_m": 2}
    changes = [{"at_s": 6, "over_s": 1, "offsets_m": far}, {"at_s": 8, "over_s": 1, "shape": line}]
    overrides = {"formation.task": "relative_position", "formation.changes": changes}
    if size > LARGEST:
        with pytest.raises(
            PtnsbcError, match=r"changes\[0\]\.offsets_m\.2\[0\]: 1e\+308: expected <= 1e\+12"
        ):
            load_scenario("paper_5", overrides)
    else:
        assert len(load_scenario("paper_5", overrides).formation.changes) == 2
