"""The formation tasks: values by hand, where they are singular, what the paper prints instead, and their table."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_arrays import on_arrays

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.nullspace import damped_solve
from ptnsbc_core.tasks import formation_tasks as tasks
from ptnsbc_core.tasks.formation_tasks import (
    FORMATION_TASKS,
    SOFTENING_M2,
    DistanceAngles,
    ParentAngle,
    RelativePosition,
    conditioning,
    desired_value,
    evaluate,
    softened,
    task_error,
)
from ptnsbc_core.tasks.table import TASKS

damped_solve = on_arrays(damped_solve)
distance_angles = on_arrays(DistanceAngles.evaluate)
desired_value = on_arrays(desired_value)
evaluate = on_arrays(evaluate)
task_error = on_arrays(task_error)

ONES = np.ones(3)
EQUAL = (1.0, 1.0, 1.0)
LEADER = np.zeros(3)
ANCHOR = np.array([2.0, 0.0, 0.0])
OFFSETS = {
    1: LEADER,
    2: np.array([-1.2, -2.4, 0.0]),
    3: np.array([-0.6, -1.2, 0.0]),
    4: np.array([0.6, -1.2, 0.0]),
    5: np.array([1.2, -2.4, 0.0]),
}


@given(square=st.floats(0.0, 1.0) | st.floats(0.0, 1e12) | st.floats(0.099, 0.101))
def test_the_softening_is_left_out_where_it_rounds_to_nothing(square: float) -> None:
    assert softened(square) == square + SOFTENING_M2 * math.exp(-square / SOFTENING_M2)


def test_value_by_hand() -> None:
    """Parent one metre east, reference to the north-east and up: 45 degrees to the left, 45 up."""
    own, parent = np.zeros(3), np.array([1.0, 0, 0])
    geometry = distance_angles(own, parent, np.array([1.0, 1, 1]))
    np.testing.assert_allclose(geometry.value, [1.0, np.pi / 4, np.pi / 4])
    np.testing.assert_array_equal(geometry.periodic, [0, 1, 1])
    # one metre towards the parent shortens the distance by one
    np.testing.assert_allclose(geometry.own[0], [-1, 0, 0])


@pytest.mark.parametrize("quadrant", range(8))
def test_signed_angle_in_all_quadrants(quadrant: int) -> None:
    angle = wrap_angle(np.pi / 8 + quadrant * np.pi / 4)
    reference = np.array([np.cos(angle), np.sin(angle), 0.3])
    value = distance_angles(np.zeros(3), np.array([2.0, 0, 0.1]), reference).value
    assert value[1] == pytest.approx(angle)


def printed_angle(a: np.ndarray, b: np.ndarray) -> float:
    """(24): z_ij . z_ik decides the branch, with the same letter for z_ij and for Q0 z_ij."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    angle = np.arccos(np.clip(a @ b, -1.0, 1.0))
    return angle if a @ b >= 0.0 else 2.0 * np.pi - angle


def test_24_takes_the_wrong_branch_in_half_the_cases() -> None:
    rng = np.random.default_rng(0)
    wrong = 0
    for _ in range(2000):
        own, parent, reference = rng.normal(size=(3, 3))
        ours = distance_angles(own, parent, reference).value[1]
        printed = printed_angle((parent - own)[:2], (reference - own)[:2])
        wrong += abs(wrap_angle(printed - ours)) > 1e-6
    assert wrong / 2000 == pytest.approx(0.5, abs=0.03)


@given(seed=st.integers(0, 2**31))
def test_gradients_of_the_design(seed: int) -> None:
    """(-Q0 a)^T / |a|^2 for the parent, (Q0 b)^T / |b|^2 for the reference, in XOY and XOZ."""
    own, parent, reference = np.random.default_rng(seed).uniform(-5.0, 5.0, (3, 3))
    q0 = np.array([[0.0, -1.0], [1.0, 0.0]])
    geometry = distance_angles(own, parent, reference)
    for row, axes in ((1, [0, 1]), (2, [0, 2])):
        a, b = (parent - own)[axes], (reference - own)[axes]
        if min(np.linalg.norm(a), np.linalg.norm(b)) < 0.5:
            continue
        to_a, to_b = -q0 @ a / (a @ a), q0 @ b / (b @ b)
        np.testing.assert_allclose(geometry.parent[row, axes], to_a, atol=1e-9)
        np.testing.assert_allclose(geometry.reference[row, axes], to_b, atol=1e-9)
        np.testing.assert_allclose(geometry.own[row, axes], -to_a - to_b, atol=1e-9)


@pytest.mark.parametrize(
    ("uav", "parent", "reference", "least"),
    [(2, 1, ANCHOR, 0.148), (3, 2, LEADER, 1.0), (4, 3, LEADER, 0.404), (5, 4, LEADER, 0.373)],
)
def test_conditioning_of_paper_5(
    uav: int, parent: int, reference: np.ndarray, least: float
) -> None:
    own, above = OFFSETS[uav], OFFSETS[parent]
    assert conditioning(TASKS["distance_angles"], own, above, reference, EQUAL) == pytest.approx(
        least, abs=5e-4
    )
    jacobian = evaluate(TASKS["distance_angles"], own, above, reference).own
    singular = np.linalg.svd(jacobian, compute_uv=False)[-1]
    assert conditioning(TASKS["distance_angles"], own, above, reference, EQUAL) == pytest.approx(
        singular
    )


def test_a_follower_of_the_leader_needs_a_heading_anchor() -> None:
    """With j = k both vectors are the same: the angles say nothing, one row is left."""
    jacobian = evaluate(TASKS["distance_angles"], OFFSETS[2], LEADER, LEADER).own
    assert np.linalg.matrix_rank(jacobian) == 1


def test_right_angle_at_the_reference_is_singular() -> None:
    """A right-angled V, UAV 3 and 4 on its arms behind the leader: 90 degrees at k."""
    v3, v4 = np.array([-1.0, -1, 0]), np.array([1.0, -1, 0])
    assert conditioning(TASKS["distance_angles"], v4, v3, LEADER, EQUAL) == pytest.approx(
        0.0, abs=1e-7
    )
    assert conditioning(TASKS["distance_angles"], v4, v3 * 1.3, LEADER, EQUAL) < 1e-7
    flatter = v4 * np.array([1.0, 0.7, 1.0])
    assert (
        conditioning(TASKS["distance_angles"], flatter, v3 * np.array([1, 0.7, 1]), LEADER, ONES)
        > 0.1
    )


def test_damped_velocity_at_a_right_angle_is_bounded() -> None:
    v3, v4 = np.array([-1.0, -1, 0]), np.array([1.0, -1, 0])
    jacobian = evaluate(TASKS["distance_angles"], v4, v3, LEADER).own
    velocity = damped_solve(jacobian, ONES, np.zeros(3), 0.35, 0.5).velocity
    assert np.linalg.norm(velocity) <= np.linalg.norm(ONES) / 0.35


def flown(error_of, seconds: float = 3.0) -> tuple[float, float]:
    """Task error of UAV 3 at the start and after `seconds` of v = J^-1 error, parent and leader at rest."""
    desired = desired_value(TASKS["distance_angles"], OFFSETS[3], OFFSETS[2], LEADER)
    position = OFFSETS[3] + np.array([0.3, -0.2, 0.2])
    first = None
    for _ in range(round(seconds / 0.01)):
        geometry = evaluate(TASKS["distance_angles"], position, OFFSETS[2], LEADER)
        error = task_error(geometry, desired)
        first = np.linalg.norm(error) if first is None else first
        rate = error_of(geometry, desired)
        solved = damped_solve(geometry.own, rate, np.zeros(3), 0.35, 0.5)
        position = position + 0.01 * solved.velocity
    geometry = evaluate(TASKS["distance_angles"], position, OFFSETS[2], LEADER)
    return first, np.linalg.norm(task_error(geometry, desired))


def test_printed_absolute_error_diverges_where_the_signed_one_converges() -> None:
    first, last = flown(lambda geometry, desired: task_error(geometry, desired))
    assert last < first * np.exp(-3.0) * 1.1
    first, last = flown(lambda geometry, desired: np.abs(desired - geometry.value))
    assert last > 2.0 * first


def test_table_2_start_of_uav_3_is_where_the_printed_law_divides_by_zero() -> None:
    """UAV 2 and 3 share x and z: (28) divides by the length of a projection that has none."""
    own, parent, leader = np.array([-1.0, 0, 1]), np.array([-1.0, -1, 1]), np.array([0.0, 1, 1])
    a = (parent - own)[[0, 2]]
    assert np.linalg.norm(a) == 0.0
    geometry = distance_angles(own, parent, leader)
    assert np.all(np.isfinite(geometry.value))
    desired = desired_value(TASKS["distance_angles"], OFFSETS[3], OFFSETS[2], LEADER)
    solved = damped_solve(geometry.own, task_error(geometry, desired), np.zeros(3), 0.35, 0.5)
    assert np.linalg.norm(solved.velocity) < 10.0


@given(value=st.floats(-np.pi, np.pi), desired=st.floats(-np.pi, np.pi))
def test_angle_errors_are_wrapped_and_distance_errors_are_not(value: float, desired: float) -> None:
    geometry = distance_angles(np.zeros(3), np.array([10.0, 0, 0]), np.array([1.0, 1, 1]))
    geometry = geometry._replace(value=np.array([10.0, value, value]))
    error = task_error(geometry, np.array([1.0, desired, desired]))
    assert error[0] == -9.0
    assert -np.pi <= error[1] < np.pi
    assert np.cos(error[1]) == pytest.approx(np.cos(desired - value), abs=1e-12)


parent_angle = on_arrays(ParentAngle.evaluate)


def test_parent_angle_by_hand() -> None:
    """Parent at the origin looks at the leader in the north; the UAV is 5 m to the east, 12 m above."""
    geometry = parent_angle(np.array([5.0, 0, 12]), np.zeros(3), np.array([0.0, 3, 0]))
    np.testing.assert_allclose(geometry.value, [13.0, -np.pi / 2, 12.0])
    np.testing.assert_array_equal(geometry.periodic, [0, 1, 0])
    np.testing.assert_allclose(
        geometry.own, [[5 / 13, 0, 12 / 13], [0, 1 / 5, 0], [0, 0, 1]], atol=1e-15
    )


flat = st.tuples(st.floats(0.2, 6.0), st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi))


@given(place=flat)
def test_conditioning_of_a_flat_formation(place: tuple[float, float, float]) -> None:
    """sigma_min = min(1, 1/rho), wherever the UAV and the reference are seen from the parent."""
    rho, bearing, towards = place
    own = rho * np.array([np.cos(bearing), np.sin(bearing), 0.0])
    reference = 3.0 * np.array([np.cos(towards), np.sin(towards), 0.0])
    found = conditioning(TASKS["parent_angle"], own, np.zeros(3), reference, ONES)
    assert found == pytest.approx(min(1.0, 1.0 / rho), rel=1e-6)
    scaled = conditioning(
        TASKS["parent_angle"], own, np.zeros(3), reference, np.array([1.0, rho, 1.0])
    )
    assert scaled == pytest.approx(1.0, rel=1e-6)


def test_where_distance_angles_vanishes_this_one_does_not() -> None:
    own, parent, leader = np.array([1.0, -1, 0]), np.array([-1.0, -1, 0]), np.zeros(3)
    assert conditioning(TASKS["distance_angles"], own, parent, leader, ONES) < 1e-7
    assert conditioning(TASKS["parent_angle"], own, parent, leader, ONES) == pytest.approx(0.5)


@given(seed=st.integers(0, 2**31))
def test_relative_position_is_never_singular(seed: int) -> None:
    own, parent, leader = np.random.default_rng(seed).normal(size=(3, 3))
    np.testing.assert_array_equal(
        RelativePosition.evaluate(own, parent, leader).value, own - parent
    )
    assert conditioning(TASKS["relative_position"], own, parent, leader, ONES) == 1.0


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
    assert tasks.evaluate(TASKS[task], *POINTS) == LAWS[task](*POINTS)


@pytest.mark.parametrize("task", TASKS)
def test_the_rows_that_are_angles_are_those_whose_errors_are_wrapped(task: str) -> None:
    periodic = tasks.evaluate(TASKS[task], *POINTS).periodic
    assert FORMATION_TASKS[task].angles == tuple(row > 0.0 for row in periodic)


def test_nothing_else_lists_the_tasks() -> None:
    """A task is added in the table alone: no other module may name two of them, in whatever form."""
    tasks = ROOT / "ptnsbc_core" / "tasks"
    allowed = {tasks / "table.py", tasks / "formation_tasks.py"}  # its line, and its class
    word = re.compile(rf"(?:\b|_)({'|'.join(TASKS)})\b", re.IGNORECASE)
    lists = {
        str(path.relative_to(ROOT)): sorted(names)
        for folder in (*ROOT.glob("ptnsbc*"), ROOT / "bench", ROOT / "docs" / "make")
        for path in folder.rglob("*.py")
        if path not in allowed
        and len(names := {name.lower() for name in word.findall(path.read_text("utf-8"))}) > 1
    }
    assert lists == {}
