"""One source of every law: compiled equals interpreted, and an edited law never runs in its old form."""

import math
import os
import runpy
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import ptnsbc_core
from ptnsbc_core.kernel import COMPILED, formula, kernel, kernel_list

PROBE = Path(__file__).with_name("step_probe.py")
ROOT = Path(ptnsbc_core.__file__).resolve().parent.parent


def run(*arguments: str, **environment: str) -> str:
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, "PYTHONPATH": paths, **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif(not COMPILED, reason="numba is absent or switched off: nothing to compare")
def test_compiled_step_equals_the_interpreted_one(tmp_path: Path) -> None:
    run(str(PROBE), str(tmp_path / "plain.npz"), PTNSBC_JIT="0")
    compiled = runpy.run_path(str(PROBE))["outputs"]()
    with np.load(tmp_path / "plain.npz") as plain:
        assert not plain["compiled"]
        assert set(compiled) == set(plain.files) - {"compiled"}
        for name, value in compiled.items():
            assert np.all(np.isfinite(value)), name
            np.testing.assert_allclose(value, plain[name], rtol=1e-12, atol=1e-12, err_msg=name)


def test_probe_reaches_the_branches_that_matter() -> None:
    found = runpy.run_path(str(PROBE))["outputs"]()
    for name, floor in (("active_rows", 1.0), ("holding", 1.0), ("velocity_error", 0.1)):
        assert max(value for key, value in found.items() if key.endswith(name)) >= floor


def test_interpreted_form_on_request() -> None:
    code = "from ptnsbc_core.kernel import COMPILED, kernel; f = lambda x: x; print(COMPILED, kernel(f) is f)"
    assert run("-c", code, PTNSBC_JIT="0").split() == ["False", "True"]


class Pose(NamedTuple):
    place: tuple[float, float, float]
    number: int
    known: bool
    table: np.ndarray


@kernel
def swap(poses: Sequence[Pose]) -> float:
    first, total = poses[0].place, 0.0
    poses[0] = Pose(poses[1].place, poses[1].number + 1, not poses[1].known, 2.0 * poses[1].table)
    for k in range(poses[0].table.shape[0]):
        total += poses[0].table[k]
    return total + first[1]


def test_a_kernel_list_is_a_list_that_kernels_write() -> None:
    table = np.zeros(2)
    poses = kernel_list(
        [
            Pose((1.0, 2.0, 3.0), 4, True, table),
            Pose((5.0, 6.0, 7.0), 8, False, np.array([1.0, 2.0])),
        ]
    )
    assert swap(poses) == 8.0
    assert len(poses) == 2
    assert poses[0][:3] == ((5.0, 6.0, 7.0), 9, True)
    np.testing.assert_array_equal(poses[0].table, [2.0, 4.0])
    if COMPILED:
        assert poses[0].table is table  # its numbers were written
    poses[1] = Pose((0.0, 0.0, 0.0), 0, True, np.array([3.0, 4.0]))
    assert swap(poses) == 20.0


@formula
def turned(x: tuple[float, float], angle: float, at: int, out: np.ndarray) -> tuple[float, float]:
    out[at] = math.hypot(x[0], x[1]) - abs(-angle) / 3
    return math.cos(angle) * x[0] - out[at], 1 - 2 * (math.sin(angle) * x[1] + at)


@kernel
def both_turned(angle: float, out: np.ndarray) -> tuple[float, float]:
    one = turned((1.0, 2.0), angle, 0, out)
    return turned(one, angle, 1, out)


def test_a_formula_is_its_own_operations() -> None:
    found, expected = np.zeros(2), np.zeros(2)
    law = getattr(both_turned, "py_func", both_turned)
    assert both_turned(0.7, found) == law(0.7, expected)
    np.testing.assert_array_equal(found, expected)
