"""What a UAV flies by: the leader has neither law nor task, and every UAV a controller."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from ptnsbc_sim.own_uav import OURS, UavFunctions
from ptnsbc_sim.scenario import load_scenario

EXAMPLES = Path(__file__).parents[2] / "examples" / "plugins"


def test_by_the_part_of_the_uav() -> None:
    scenario = load_scenario(EXAMPLES / "all.yaml")
    leader, follower = (UavFunctions.of(scenario, uav) for uav in (1, 2))
    assert (leader.task, leader.law, follower.law) == (None, None, None)
    assert follower.task is not None and follower.controller is leader.controller is not None
    assert UavFunctions.of(load_scenario("paper_5_free"), 2) == OURS


def test_an_installed_package_brings_functions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = tmp_path / "own_tasks-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-tasks\nVersion: 1\n")
    entries = "task.drum = own_tasks:cylinder\nlaw.agree = own_laws:consensus\n"
    (info / "entry_points.txt").write_text(f"[ptnsbc.plugins]\n{entries}")
    (tmp_path / "own_tasks.py").write_text((EXAMPLES / "cylinder.py").read_text("utf-8"), "utf-8")
    law = EXAMPLES.parent / "laws" / "consensus.py"
    (tmp_path / "own_laws.py").write_text(law.read_text("utf-8"), "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    own = load_scenario("paper_5_free", {"plugins.task": "drum"})
    assert own.plugins.task == f"{tmp_path}/own_tasks.py:cylinder"
    assert UavFunctions.of(own, 2).task is not None
    assert (
        load_scenario("paper_5_free", {"law": "agree"}).law == f"{tmp_path}/own_laws.py:consensus"
    )
    for module in ("own_tasks", "own_laws"):
        sys.modules.pop(module, None)
