"""One source of every law: compiled equals interpreted, and an edited law never runs in its old form."""

import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ptnsbc_core
from ptnsbc_core.kernel import COMPILED, kernel_list

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


def test_a_kernel_list_is_a_list() -> None:
    items = kernel_list([np.zeros(3), np.ones(3)])
    assert len(items) == 2
    items[0] = np.full(3, 2.0)
    np.testing.assert_array_equal(items[0], [2, 2, 2])
