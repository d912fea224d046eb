"""New scenarios: every shape and size is a scenario that the check accepts, with the distances asked for."""

from __future__ import annotations

import math
from itertools import combinations
from pathlib import Path

import pytest

import ptnsbc
from ptnsbc_sim.scenario import scenario_from_text
from ptnsbc_tools.library.flying import check
from ptnsbc_tools.library.new_scenario import SHAPES, NewScenarioError, named, places, text_of


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("n", [2, 3, 8, 21])
def test_neighbours_are_as_far_apart_as_asked(shape: str, n: int) -> None:
    at = [(0.0, 0.0, 0.0), *places(shape, n, 2.0).values()]
    assert len(at) == n
    assert min(math.dist(a, b) for a, b in combinations(at, 2)) == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_check_accepts_the_file(shape: str) -> None:
    made = scenario_from_text(text_of("mine", shape, 7), source=shape)
    found = check(made, dry_runs=0)
    assert [one for one in found if one.severity != "info"] == []
    assert (made.name, len(made.uav_ids)) == ("mine", 7)


def test_the_file_flies() -> None:
    made = scenario_from_text(text_of("mine", "v", 4)).with_({"timing.duration_s": 8})
    assert check(made, dry_runs=1).ok


@pytest.mark.parametrize(
    ("shape", "n", "spacing", "match"),
    [
        ("vee", 5, 2.0, r"--shape vee: "),
        ("v", 1, 2.0, r"--n 1: expected 2 to 254"),
        ("v", 5, 0.1, r"--spacing 0\.1: expected 1 to 100 m"),
        ("v", 5, math.nan, r"--spacing nan: expected"),
    ],
)
def test_what_cannot_be_made_is_refused(shape: str, n: int, spacing: float, match: str) -> None:
    with pytest.raises(NewScenarioError, match=match):
        places(shape, n, spacing)


def test_a_file_gives_its_name() -> None:
    assert named(Path("a b/my flock ü.yaml")) == "my_flock__"


def test_the_library_writes_the_file_that_the_check_accepts(tmp_path: Path) -> None:
    file = ptnsbc.new(tmp_path / "mine", "line", 3)
    assert file == tmp_path / "mine.yaml"
    assert ptnsbc.check(ptnsbc.load(file), dry_runs=0).ok
    with pytest.raises(NewScenarioError, match="exists"):
        ptnsbc.new(file)
