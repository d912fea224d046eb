"""Tasks of the user: derivatives against closed forms, wrong ones named with file and line, and a flight."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_core.algebra import sub3
from ptnsbc_core.step import TaskPoints
from ptnsbc_sim.plugins.formation_task import NO_TASK, load_task
from ptnsbc_sim.plugins.loader import PluginError
from ptnsbc_sim.scenario import ScenarioError, load_scenario

CYLINDER = f"{Path(__file__).parents[3] / 'examples' / 'plugins' / 'cylinder.py'}:cylinder"


@pytest.mark.parametrize("seed", range(5))
def test_the_derivatives_are_those_of_the_closed_form(seed: int) -> None:
    own, parent, reference = map(tuple, np.random.default_rng(seed).uniform(-3, 3, (3, 3)).tolist())
    found = load_task(CYLINDER).geometry(own, parent, reference)
    x, y, z = sub3(own, parent)
    r = math.hypot(x, y)
    np.testing.assert_allclose(found.value, [r, math.atan2(y, x), z], rtol=1e-12)
    expected = [[x / r, y / r, 0.0], [-y / r**2, x / r**2, 0.0], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(found.own, expected, atol=1e-8)
    np.testing.assert_allclose(found.parent, -np.array(expected), atol=1e-8)
    np.testing.assert_array_equal(found.reference, np.zeros((3, 3)))
    assert found.periodic == (0.0, 1.0, 0.0)


def test_an_angle_is_differentiated_across_its_cut() -> None:
    found = load_task(CYLINDER).geometry((-2.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(found.own[1], [0.0, -0.5, 0.0], atol=1e-8)


def test_the_rows_are_put_into_metres() -> None:
    zero = np.zeros(3)
    value, scale = load_task(CYLINDER).desired(np.array([3.0, 4.0, 1.0]), zero, zero)
    assert value == pytest.approx((5.0, math.atan2(4, 3), 1.0))
    assert scale == pytest.approx((1.0, 5.0, 1.0), rel=1e-8)


def test_without_a_parent_nothing_is_called() -> None:
    here = (0.0, 0.0, 0.0)
    assert load_task(CYLINDER).at(TaskPoints(here, here, here, False)) is NO_TASK


@pytest.mark.parametrize(
    ("lines", "match"),
    [
        (("return own[0], own[1], 0.0",), r"mine\.py:1: task: .*expected three independent rows"),
        (("return own[0], own[1]",), r"mine\.py:1: task: returned .*expected three numbers"),
        (
            ("a = 1.0 / (own[0] - own[0])", "return a, a, a"),
            r"mine\.py:2: task: ZeroDivisionError",
        ),
        (("return own", "task.angles = (3,)"), r"angles = \(3,\): expected the rows"),
    ],
)
def test_a_task_that_cannot_be_flown_is_named(
    tmp_path: Path, lines: tuple[str, ...], match: str
) -> None:
    body = [f"    {line}" if not line.startswith("task.") else line for line in lines]
    file = tmp_path / "mine.py"
    file.write_text("\n".join(["def task(own, parent, reference):", *body]) + "\n", "utf-8")
    scenario = load_scenario("paper_5_free", {"plugins.task": f"{file}:task"})
    from ptnsbc_sim.scenario import agent_config

    with pytest.raises(PluginError, match=match):
        agent_config(scenario, 2)


def test_a_mission_that_changes_the_shape_is_refused() -> None:
    with pytest.raises(
        ScenarioError, match=r"formation: expected a shape that does not move, without .* changes"
    ):
        load_scenario("mission_6", {"plugins.task": CYLINDER})
