"""Boxes that cover a point cloud."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.occupancy import MOST_BOXES, boxes_of, covering_boxes, map_text
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.scenario.scenario import scenario_from_text
from ptnsbc_sim.sweep.draws import parse_starts
from ptnsbc_sim.sweep.plan import drawn_scenario, plan_of

CELLS = st.lists(st.tuples(*[st.integers(-4, 4)] * 3), min_size=1, max_size=80, unique=True)


@given(CELLS)
def test_the_boxes_are_the_occupied_cells_each_once(cells: list[tuple[int, int, int]]) -> None:
    points = (np.array(cells) + 0.5) * 0.25
    covered = []
    for box in (covering_boxes(points, 0.25) / 0.25).round().astype(int).tolist():
        spans = [range(a, b) for a, b in zip(box[:3], box[3:], strict=True)]
        covered += [(x, y, z) for x in spans[0] for y in spans[1] for z in spans[2]]
    assert sorted(covered) == sorted(cells)


def test_a_full_block_is_one_box() -> None:
    cells = np.stack(np.meshgrid(*[np.arange(n) for n in (4, 6, 8)]), axis=-1).reshape(-1, 3)
    assert covering_boxes(cells + 0.5, 1.0).tolist() == [[0, 0, 0, 4, 6, 8]]


def test_too_many_boxes_are_refused() -> None:
    apart = 2.0 * np.arange(MOST_BOXES + 1)[:, None] * np.array([[1.0, 0.0, 0.0]])
    with pytest.raises(PtnsbcError, match=r"401 boxes: expected at most 400, raise resolution_m"):
        covering_boxes(apart, 1.0)
    assert len(covering_boxes(apart, 3.0)) < MOST_BOXES


def test_the_text_of_a_map_is_read_back(tmp_path: Path) -> None:
    points = np.random.default_rng(3).uniform(-5, 5, (300, 3))
    np.save(tmp_path / "a.npy", points)
    text = map_text(".npy", (tmp_path / "a.npy").read_bytes(), 1.3)
    np.testing.assert_allclose(boxes_of(text), covering_boxes(points, 1.3), rtol=1e-9)


def test_a_scenario_with_a_map_holds_the_boxes_and_no_name_of_a_file() -> None:
    found = load_scenario("yard")
    assert "yard.pcd" not in found.text
    assert [one.name for one in found.world.bodies[:2]] == ["yard-1", "yard-2"]
    assert {one.kind for one in found.world.bodies} == {"box", "ground"}
    again = scenario_from_text(found.text, complete=True)
    assert again == found
    assert again.text == found.text


def test_drawn_starts_keep_clear_of_the_boxes() -> None:
    plan = plan_of(load_scenario("yard"), 2, starts=parse_starts("box:40,14,6"))
    drawn, _ = drawn_scenario(plan, 1)
    places = np.stack([drawn.uav(uav).position for uav in drawn.uav_ids])
    for one in drawn.world.bodies:
        assert one.distances(places, np.zeros(len(places))).min() >= one.keep_out_m


def test_a_map_is_as_far_as_its_nearest_cell() -> None:
    """Of 2000 places outside, also those of a corner and beside a joint of two boxes."""
    points = np.loadtxt(Path(__file__).parents[2] / "scenarios/yard.pcd", skiprows=11)
    found = load_scenario("yard").world.bodies[:-1]
    places = np.random.default_rng(1).uniform([-3, -8, 0.5], [28, 8, 9], (2000, 3))
    beside = np.abs(places[:, None] - points[None]) - 0.25
    wanted = np.linalg.norm(np.maximum(beside, 0.0), axis=2).min(axis=1)
    given = np.min([one.distances(places, np.zeros(2000)) for one in found], axis=0)
    np.testing.assert_allclose(given[wanted > 0.0], wanted[wanted > 0.0], atol=1e-9)
    assert (given[wanted == 0.0] <= 0.0).all()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"file": "none.pcd", "resolution_m": 1}, r"obstacles\[0\]\.file: .*none\.pcd: No such file or directory"),
        ({"file": 7}, r"obstacles\[0\]\.file: 7: expected the name or path of a file"),
        ({"file": "a.csv", "resolution_m": 0}, r"\[0\]\.resolution_m: 0: expected a number from"),
        ({"file": "a.csv", "resolution_m": None}, r"\[0\]\.resolution_m: None: expected a number"),
        ({"file": "a.csv", "resolution_m": 1e-3}, r"resolution_m: 0\.001: expected a number from 0\.01"),
        ({"resolution_m": 1}, r"\[0\]\.samples: missing: expected file: NAME and resolution_m, or"),
        ({"samples": "1,2"}, r"\[0\]\.samples: row 1: 2 numbers: expected x, y, z, x, y, z"),
        ({"samples": "1,1,1,0,2,2"}, r"\[0\]\.samples: expected boxes whose second corner"),
        ({"samples": "0,0,0,1,1,1", "radius_m": 1}, r"radius_m: not a key of kind map: expected file"),
    ],
)  # fmt: skip
def test_a_bad_map_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, keys: dict[str, object], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text("1,2,3\n")
    block = {"name": "hall", "kind": "map", "keep_out_m": 0.5, **keys}
    with pytest.raises(PtnsbcError, match=message):
        load_scenario("paper_5", {"world.obstacles": [block]})


def test_the_edge_of_a_cell_may_have_its_unit(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("intensity,z,y,x\n9,3.5,2.5,1.5\n")
    block = {"name": "hall", "kind": "map", "keep_out_m": 0.5, "file": str(tmp_path / "a.csv")}
    for edge in (1, "1 m"):
        (body,) = load_scenario(
            "paper_5", {"world.obstacles": [{**block, "resolution_m": edge}]}
        ).world.bodies
        np.testing.assert_array_equal(body.position, [1.5, 2.5, 3.5])


def test_no_more_bodies_than_a_sensor_tells_of() -> None:
    box = "".join(f"{2 * k},0,0,{2 * k + 1},1,1\n" for k in range(MOST_BOXES))
    maps = [{"name": f"map{k}", "kind": "map", "keep_out_m": 0.5, "samples": box} for k in range(3)]
    with pytest.raises(PtnsbcError, match=r"world\.obstacles: 1205 bodies .* at most 1024"):
        load_scenario("paper_5", {"world.obstacles": maps})


def test_a_text_from_outside_names_no_map() -> None:
    text = load_scenario("yard").text.replace("samples: ", "file: yard.pcd\n    name_: ", 1)
    with pytest.raises(PtnsbcError, match=r"obstacles\[0\]\.file: not here: expected samples"):
        scenario_from_text(text, complete=True)


def test_a_box_of_a_map_and_an_obstacle_do_not_share_a_name() -> None:
    hall = {"name": "hall", "kind": "map", "samples": "0,0,0,1,1,1", "keep_out_m": 0.5}
    other = {"name": "hall-1", "position_m": [9, 9, 9], "keep_out_m": 0.5}
    with pytest.raises(PtnsbcError, match=r'obstacles\[1\].name: "hall-1": a box of world'):
        load_scenario("paper_5", {"world.obstacles": [hall, other]})
