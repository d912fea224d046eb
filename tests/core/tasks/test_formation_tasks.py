"""The table of the tasks: it says what the tasks do, and nothing else lists them."""

import re
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_core.tasks.formation_tasks import (
    FORMATION_TASKS,
    TASKS,
    evaluate,
)

ROOT = Path(__file__).parents[3]
POINTS = (np.array([1.0, 2.0, 3.0]), np.array([-1.0, 0.5, 2.0]), np.array([2.0, -3.0, 1.0]))
LAWS = {name: task.evaluate for name, task in FORMATION_TASKS.items()}


def test_numbers_that_flights_were_computed_with_stay() -> None:
    assert list(TASKS.items())[:3] == [
        ("distance_angles", 0),
        ("parent_angle", 1),
        ("relative_position", 2),
    ]


@pytest.mark.parametrize("task", LAWS)
def test_each_number_is_the_task_of_its_name(task: str) -> None:
    assert evaluate(TASKS[task], *POINTS) == LAWS[task](*POINTS)


@pytest.mark.parametrize("task", TASKS)
def test_the_rows_that_are_angles_are_those_whose_errors_are_wrapped(task: str) -> None:
    periodic = evaluate(TASKS[task], *POINTS).periodic
    assert FORMATION_TASKS[task].angles == tuple(row > 0.0 for row in periodic)


def test_nothing_else_lists_the_tasks() -> None:
    """A task is added in the table alone: no other module may name two of them, in whatever form."""
    allowed = {ROOT / "ptnsbc_core" / "tasks" / "formation_tasks.py"}
    word = re.compile(rf"(?:\b|_)({'|'.join(TASKS)})\b", re.IGNORECASE)
    lists = {
        str(path.relative_to(ROOT)): sorted(names)
        for folder in (*ROOT.glob("ptnsbc*"), ROOT / "bench", ROOT / "docs" / "make")
        for path in folder.rglob("*.py")
        if path not in allowed
        and len(names := {name.lower() for name in word.findall(path.read_text("utf-8"))}) > 1
    }
    assert lists == {}
