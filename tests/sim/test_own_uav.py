"""Functions that a UAV flies by, of every kind, of a file or of an installed package; the leader has no law."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_core.kernel import COMPILED
from ptnsbc_sim.own_uav import OURS, UavFunctions
from ptnsbc_sim.scenario import Scenario, load_scenario
from ptnsbc_sim.swarm import fly

EXAMPLES = Path(__file__).parents[2] / "examples" / "plugins"


def test_by_the_part_of_the_uav() -> None:
    scenario = load_scenario(EXAMPLES / "all.yaml")
    leader, follower = (UavFunctions.of(scenario, uav) for uav in (1, 2))
    assert (leader.task, leader.law, follower.law) == (None, None, None)
    assert follower.task is not None and follower.controller is leader.controller is not None
    assert UavFunctions.of(load_scenario("paper_5_free"), 2) == OURS


KINDS = {  # the key that names a function of this kind, and its example
    "law": ("law", "laws/consensus.py:consensus"),
    "task": ("plugins.task", "plugins/cylinder.py:cylinder"),
    "controller": ("plugins.controller", "plugins/proportional.py:proportional"),
    "plant": ("plugins.plant", "plugins/square_drag.py:square_drag"),
    "disturbance": ("plugins.disturbance", "plugins/thermal.py:thermal"),
    "sensor": ("plugins.sensor", "plugins/camera.py:camera"),
}
RETURNS = {
    "law": "0.0, 0.0, 0.0",
    "task": "inputs[0][0] - inputs[1][0], inputs[0][1] - inputs[1][1], inputs[0][2] - inputs[1][2]",
    "controller": "inputs[0].wrench",
    "plant": "np.zeros(17)",
    "disturbance": "np.zeros(6)",
    "sensor": "np.zeros((0, 7))",
}


def _flown(kind: str, named: str) -> Scenario:
    """A flight of two ticks with a function of the user."""
    keys = {KINDS[kind][0]: named, "plant.kind": "quadrotor", "timing.duration_s": 0.02}
    scenario = load_scenario("paper_5_free", keys)
    assert np.isfinite(fly(scenario).track.odometry).all()
    return scenario


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_an_installed_package_brings_functions(
    kind: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """They are compiled, without a word."""
    file, _, name = KINDS[kind][1].rpartition(":")
    info = tmp_path / "own_package-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-package\nVersion: 1\n")
    (info / "entry_points.txt").write_text(f"[ptnsbc.plugins]\n{kind}.mine = own_package:{name}\n")
    module = tmp_path / "own_package.py"
    module.write_text((EXAMPLES.parent / file).read_text("utf-8"), "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    scenario = _flown(kind, "mine")
    sys.modules.pop("own_package")
    found = scenario.law if kind == "law" else getattr(scenario.plugins, kind)
    assert found == f"{module}:{name}"
    assert "is interpreted" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=[pytest.mark.slow] * (kind == "task")) for kind in KINDS],
)
def test_what_numba_cannot_compile_is_interpreted_with_a_word(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (
        "import json",
        "import numpy as np",
        "def mine(*inputs):" if kind == "task" else "def mine(one):",
        "    json.loads('1')",
        "" if kind == "task" else "    inputs = (one,)",
        f"    return {RETURNS[kind]}",
    )
    (tmp_path / "mine.py").write_text("\n".join(lines) + "\n", "utf-8")
    _flown(kind, f"{tmp_path}/mine.py:mine")
    said = capsys.readouterr().err
    assert not COMPILED or ("mine.py:3: mine is interpreted, numba cannot" in said)
