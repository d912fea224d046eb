"""Flights with functions of the user: a task of ours written again, and all kinds at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ptnsbc_sim.plugins.loop import PluginLoop
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.swarm import fly

EXAMPLES = Path(__file__).parents[3] / "examples" / "plugins"


def test_without_functions_the_loop_is_ours() -> None:
    assert PluginLoop.of(load_scenario("paper_5_free")) is None


@pytest.mark.slow
def test_our_task_written_again_flies_as_ours(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "def place(own, parent, reference):\n"
        "    return own[0] - parent[0], own[1] - parent[1], own[2] - parent[2]\n",
        "utf-8",
    )
    keys = {
        "timing.duration_s": 1.0,
        "formation.approach": "task",
        "formation.task": "relative_position",
    }
    ours = fly(load_scenario("paper_5_free", keys)).track.odometry
    own = fly(load_scenario("paper_5_free", {**keys, "plugins.task": f"{file}:place"}))
    np.testing.assert_allclose(own.track.odometry, ours, atol=1e-6)
    assert own.scenario.task_name == "mine.py:place"


@pytest.mark.slow
def test_all_kinds_at_once_from_one_file() -> None:
    scenario = load_scenario(EXAMPLES / "all.yaml", {"timing.duration_s": 0.5})
    first, again = fly(scenario).track, fly(scenario).track
    assert first.odometry.tobytes() == again.odometry.tobytes()
    assert np.isfinite(first.odometry).all()
