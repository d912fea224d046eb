"""New scenarios: every shape and size is a scenario that the check accepts, with the distances asked for."""

from __future__ import annotations

import math
import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import ptnsbc
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import load_scenario, scenario_from_text
from ptnsbc_sim.scenario.mission.shapes import ShapeBlock, named_places
from ptnsbc_sim.scenario.reading.reader import parse
from ptnsbc_sim.sweep.family import _places
from ptnsbc_sim.sweep.plan import SweepPlan, drawn_scenario
from ptnsbc_tools.library.flying import check
from ptnsbc_tools.library.new_scenario import SHAPES, NewScenarioError, named, new, text_of


@pytest.mark.parametrize("shape", SHAPES)
def test_a_shape_has_the_same_places_wherever_it_is_named(shape: str) -> None:
    """`ptnsbc new --shape`, the key `formation.shape` and families, for 2 to 30 UAVs."""
    for n in range(2, 31):
        written = ShapeBlock.model_validate(
            parse(text_of("mine", shape, n), "mine")["formation"]["shape"]
        )
        places = named_places(ShapeBlock(kind=shape, spacing_m=2.0), n)
        least = min(math.dist(a, b) for a, b in combinations(places, 2))
        assert least == pytest.approx(2.0, abs=1e-9)
        assert named_places(written, n).tolist() == places.tolist()
        assert _places(shape, n, 2.0, np.random.default_rng()).tolist() == places.tolist()


@pytest.mark.parametrize("shape", SHAPES)
def test_a_shape_is_flown_in_the_same_places(shape: str) -> None:
    n, block = 6, {"kind": shape, "spacing_m": 2}
    made = scenario_from_text(text_of("mine", shape, n))
    key = scenario_from_text(text_of("mine", "grid", n)).with_({"formation.shape": block})
    family = f"{{name: of_one, size: {n}, shape: {{kinds: [{shape}], spacing_m: 2}}}}"
    drawn, _ = drawn_scenario(SweepPlan(made.text, 1, family=family), 0)
    for other in (key, drawn):
        assert other.formation.offsets_m == made.formation.offsets_m


@pytest.mark.parametrize("shape", SHAPES)
def test_the_check_accepts_the_file(shape: str) -> None:
    made = scenario_from_text(text_of("mine", shape, 7), source=shape)
    found = check(made, dry_runs=0)
    assert [one for one in found if one.severity != "info"] == []
    assert (made.name, len(made.uav_ids)) == ("mine", 7)


def test_the_file_flies() -> None:
    """The UAVs start about a metre and more from their places, and arrive."""
    made = scenario_from_text(text_of("mine", "v", 4)).with_({"timing.duration_s": 8})
    report = check(made, dry_runs=1)
    assert report.ok and report.plan["flown"].startswith("4 of 4 in place by 6 s")
    starts = [made.uav(uav).position - made.uav(1).position - made.offset(uav) for uav in (2, 3, 4)]
    assert min(np.linalg.norm(starts, axis=1)) > 0.9


def uncommented(text: str, key: str, number: int) -> str:
    """The file with one of its commented blocks; a trajectory stands in the place of the one that is there."""
    lines = text.splitlines()
    begins = [k for k, line in enumerate(lines) if re.match(rf" *# {key}:", line)]
    begin = end = begins[number]
    indent = lines[begin].index("#")
    while end == begin or lines[end].startswith(" " * indent + "#   "):
        end += 1
    lines[begin:end] = [line[:indent] + line[indent + 2 :] for line in lines[begin:end]]
    if key == "trajectory":
        lines.remove(next(line for line in lines if line.startswith("  trajectory:")))
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("key", "number"),
    [("obstacles", 0), ("mission", 0), *(("trajectory", number) for number in range(3))],
)
def test_each_commented_block_flies(key: str, number: int, tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text("0,0,5,6,0\n6,3,5,6,0.5\n60,20,9,6,0\n")
    text = uncommented(text_of("mine", "v", 4), key, number)
    assert len(text) < len(text_of("mine", "v", 4))
    made = scenario_from_text(text, folder=tmp_path)
    if key != "mission":
        made = made.with_({"timing.duration_s": 20})
    report = check(made, dry_runs=1)
    assert [one for one in report if one.severity != "info"] == []
    assert report.plan["flown"].startswith("4 of 4 in place by 6 s")


@pytest.mark.parametrize(
    ("rows", "frame", "behind"),
    [
        ("x", "heading", [0.0, -2.4, 0.0]),  # north, without a stop
        ("x,yaw", "heading", [2.4, 0.0, 0.0]),  # looks west
        ("stop", "world", [-2.4, 0.0, 0.0]),  # has no heading where it stops
    ],
)
def test_the_leader_flies_a_file(
    rows: str, frame: str, behind: list[float], tmp_path: Path
) -> None:
    """The shape turns with a path that has a heading all along, and starts as it is turned at its begin."""
    t = np.linspace(0.0, 30.0, 31)
    north = np.minimum(t, 12.0) if rows == "stop" else t
    columns = [t, np.full_like(t, 3.0), 0.5 * north, np.full_like(t, 7.0)]
    columns += [np.full_like(t, np.pi)] if rows == "x,yaw" else []
    np.savetxt(tmp_path / "a, way.csv", np.stack(columns, axis=1), delimiter=",")
    file = new(tmp_path / "below" / "mine", "column", 2, trajectory=tmp_path / "a, way.csv")
    assert 'file: "../a, way.csv"' in file.read_text("utf-8")
    made = load_scenario(file)
    assert made.formation.frame == frame
    assert made.uav(1).position.tolist() == [3.0, 0.0, 1.0]
    np.testing.assert_allclose(made.uav(2).position - [3.0, 0.0, 1.0], 1.25 * np.array(behind))
    report = check(made, dry_runs=1)
    assert report.ok and report.plan["flown"].startswith("2 of 2 in place by 6 s")


def test_a_file_that_is_no_trajectory_is_refused(tmp_path: Path) -> None:
    (tmp_path / "words.csv").write_text("a b c\n")
    for name in ("words.csv", "none.csv"):
        with pytest.raises(PtnsbcError, match=rf"{name}: leader\.trajectory\.file: "):
            new(tmp_path / "mine", trajectory=str(tmp_path / name))
    assert not (tmp_path / "mine.yaml").exists()


@pytest.mark.parametrize(
    ("shape", "n", "spacing", "match"),
    [
        ("vee", 5, 2.0, r"shape vee: "),
        ("v", 1, 2.0, r"n: 1: expected a whole number, 2 to 254"),
        ("v", 5, 0.1, r"spacing_m: 0\.1: expected 1 to 100"),
        ("v", 5, math.nan, r"spacing_m: nan: expected"),
    ],
)
def test_what_cannot_be_made_is_refused(shape: str, n: int, spacing: float, match: str) -> None:
    with pytest.raises(PtnsbcError, match=match):
        text_of("mine", shape, n, spacing)


@pytest.mark.parametrize("file", ["", "."])
def test_a_folder_is_no_name(file: str) -> None:
    with pytest.raises(NewScenarioError, match="expected a name, or a file"):
        new(file)


def test_a_file_gives_its_name() -> None:
    assert named(Path("a b/my flock ü.yaml")) == "my_flock__"


def test_the_library_writes_the_file_that_the_check_accepts(tmp_path: Path) -> None:
    file = ptnsbc.new(tmp_path / "mine", "line", 3)
    assert file == tmp_path / "mine.yaml"
    schema = file.read_text("utf-8").splitlines()[0].partition("$schema=")[2]
    assert not Path(schema).is_absolute() and (tmp_path / schema).is_file()
    assert ptnsbc.check(ptnsbc.load(file), dry_runs=0).ok
    with pytest.raises(NewScenarioError, match="exists"):
        ptnsbc.new(file)
