"""Named shapes and changes of shapes: places, distances, and what is refused."""

from itertools import combinations
from typing import Any

import numpy as np
import pytest
import yaml

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario, ScenarioError, load_scenario, scenario_from_text
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.scenario.mission.shapes import ShapeBlock, named_places

KINDS = ["v", "line", "column", "grid", "circle", "sphere"]
TO_LINE = {"at_s": 10, "over_s": 4, "shape": {"kind": "line", "spacing_m": 3}}
MOVING = {"formation.task": "relative_position"}


def figure(**changes: Any) -> Scenario:
    overrides = {key.replace("__", "."): value for key, value in changes.items()}
    return load_scenario("figure_eight", overrides)


def least(places: np.ndarray) -> float:
    return min(float(np.linalg.norm(a - b)) for a, b in combinations(places, 2))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [1, 2, 3, 7, 20])
def test_neighbours_are_a_spacing_apart(kind: str, size: int) -> None:
    block = ShapeBlock.model_validate({"kind": kind, "spacing_m": 1.5})
    places = named_places(block, size)
    assert places.shape == (size, 3)
    np.testing.assert_array_equal(places[0], np.zeros(3))
    if size > 1:
        assert least(places) == pytest.approx(1.5)


def test_v_turns_with_the_leader() -> None:
    scenario = figure()
    assert scenario.formation.moves
    path = np.array([10.0 * 0.1 * np.cos(0.1 * 7.0), 5.0 * 0.2 * np.cos(0.2 * 7.0)])
    along = path / np.linalg.norm(path)
    for uav in (2, 3):
        place = places_beside_leader(scenario, uav, np.array([7.0]))[0]
        assert place[:2] @ along == pytest.approx(-1.6)
        assert np.linalg.norm(place) == pytest.approx(2.0)


def test_a_change_is_in_place_at_its_time() -> None:
    scenario = figure(formation__changes=[TO_LINE], formation__frame="world")
    times = np.array([0.0, 10.0, 12.0, 14.0, 60.0])
    for uav in scenario.followers:
        at = places_beside_leader(scenario, uav, times)
        np.testing.assert_array_equal(at[0], scenario.offset(uav))
        np.testing.assert_allclose(at[1], at[0], atol=1e-12)
        np.testing.assert_allclose(at[2], 0.5 * (at[0] + at[3]), atol=1e-12)
        np.testing.assert_allclose(at[4], at[3], atol=1e-12)
        assert at[3][0] == pytest.approx(0.0, abs=1e-12)
        assert abs(at[3][1]) % 3.0 == pytest.approx(0.0, abs=1e-9)


def test_the_squared_ways_to_a_named_shape_are_least() -> None:
    """Then no two followers come nearer to each other than the lesser of both shapes over the root of two."""
    to = {"at_s": 10, "over_s": 4, "shape": {"kind": "sphere", "spacing_m": 2}}
    scenario = figure(formation__changes=[to], formation__frame="world")
    times = np.linspace(10.0, 14.0, 101)
    ways = np.stack([places_beside_leader(scenario, uav, times) for uav in scenario.followers])
    closest = min(least(ways[:, k]) for k in range(len(times)))
    assert closest >= 2.0 / np.sqrt(2.0) - 1e-9


def test_scale_shear_and_rotation_by_hand() -> None:
    change = {"at_s": 6, "over_s": 2, "scale": [2, 0.5, 1], "shear": 0.5, "rotation_rad": np.pi / 2}
    scenario = figure(formation__changes=[change], formation__frame="world")
    x, y, z = scenario.offset(2)
    at = places_beside_leader(scenario, 2, np.array([8.0]))[0]
    np.testing.assert_allclose(at, [-0.5 * y, 2.0 * x + 0.5 * y, z], atol=1e-12)


def test_the_text_of_a_scenario_gives_the_same_places() -> None:
    scenario = load_scenario("show_20")
    again = scenario_from_text(scenario.text, complete=True)
    assert again == scenario
    assert [one.at_s for one in again.formation.changes] == [0.0, 10.0, 21.0, 34.0, 47.0]


def test_shipped_show_keeps_its_distances_between_shapes() -> None:
    scenario = load_scenario("show_20")
    times = np.linspace(0.0, 60.0, 601)
    ways = np.stack([places_beside_leader(scenario, uav, times) for uav in scenario.uav_ids])
    assert min(least(ways[:, k]) for k in range(len(times))) > 1.1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"formation__task": "distance_angles"}, r"formation\.task: distance_angles: expected rel"),
        ({"formation__approach": "task"}, r"formation\.approach: task: expected planned"),
        (
            {"formation__offsets_m": {2: [1, 0, 0]}},
            r"formation\.shape: expected either shape or offsets_m",
        ),
        ({"formation__shape.kind": "vee"}, r"formation\.shape\.kind: \"vee\""),
        ({"formation__shape.spacing_m": 0}, r"formation\.shape\.spacing_m: 0: expected >= 0\.01"),
        (
            {"formation__changes": [TO_LINE, {"at_s": 13, "over_s": 1}]},
            r"changes\[1\]\.at_s: 13: expected at least 14",
        ),
        (
            {"formation__changes": [{"at_s": 8, "over_s": 1, "offsets_m": {2: [1, 0, 0]}}]},
            r"changes\[0\]\.offsets_m\.3: expected an offset of each follower",
        ),
        (
            {"formation__changes": [{**TO_LINE, "offsets_m": {2: [1, 0, 0]}}]},
            r"changes\[0\]\.shape: expected either",
        ),
        ({"formation__changes": [{"at_s": 8}]}, r"changes\[0\]\.over_s: missing"),
        ({"formation__changes": [{"at_s": 1e300, "over_s": 1}]}, r"at_s: 1e\+300: expected <= 1e"),
        ({"formation__changes": [{"at_s": 8, "over_s": 1e-9}]}, r"over_s: 1e-09: expected >= 0\.1"),
        (
            {"formation__changes": [{"at_s": 8, "over_s": 1, "scale": [1e300, 1, 1]}]},
            r"changes\[0\]\.scale\[0\]: 1e\+300: expected <= 1000",
        ),
        ({"formation__changes": 3}, r"formation\.changes: 3: expected a list"),
        ({"uavs": 3}, r"uavs"),
    ],
)
def test_shapes_that_are_none(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(PtnsbcError, match=words):
        figure(**changes)


PLACES = "x,y,z\n-1,1,0\n-1,-1,0\n-2,2,0\n-2,-2,0\n"


def test_a_shape_from_a_file_is_carried_by_the_scenario(tmp_path) -> None:
    (tmp_path / "places.csv").write_text(PLACES)
    mine = tmp_path / "mine.yaml"
    shape = "{kind: file, file: places.csv}"
    formation = f"{{task: relative_position, offsets_m: null, shape: {shape}}}"
    mine.write_text(f"extends: paper_5_free\nname: mine\nformation: {formation}\n")
    scenario = load_scenario(mine)
    assert [scenario.offset(uav).tolist() for uav in (1, 2, 5)] == [
        [0, 0, 0],
        [-1, 1, 0],
        [-2, -2, 0],
    ]
    assert "places.csv" not in scenario.text
    again = scenario_from_text(scenario.text, complete=True)
    np.testing.assert_array_equal(again.offset(4), [-2, 2, 0])


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ({"kind": "v"}, "formation.shape.spacing_m: missing"),
        ({"kind": "file"}, "formation.shape.file: missing"),
        ({"kind": "file", "file": "nowhere.csv"}, "formation.shape.file: "),
        ({"kind": "file", "samples": "1,2,3\n"}, "formation.shape.samples: 1 places: expected 4"),
        (
            {"kind": "file", "samples": "1,2\n" * 4},
            "formation.shape.samples: row 1: 2 numbers: expected x, y, z",
        ),
        (
            {"kind": "file", "samples": "1,2,nan\n" * 4},
            "formation.shape.samples: row 1: expected finite numbers",
        ),
    ],
)
def test_a_shape_that_does_not_fit_is_named(shape: dict, said: str) -> None:
    text = yaml.safe_dump(
        {
            "extends": "paper_5_free",
            "formation": {"task": "relative_position", "offsets_m": None, "shape": shape},
        }
    )
    with pytest.raises(ScenarioError) as caught:
        scenario_from_text(text)
    assert said in str(caught.value)
