"""Controllers of the user: ours passed on gives our flight, and a wrong one is named with file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ptnsbc_sim.own_controller import load_controller
from ptnsbc_sim.scenario import agent_config, load_scenario
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.user_file import UserFileError

KEYS = {"timing.duration_s": 1.0, "plant.kind": "quadrotor"}
SOFTER = f"{Path(__file__).parents[2] / 'examples' / 'plugins' / 'proportional.py'}:proportional"


def _written(folder: Path, *lines: str) -> str:
    file = folder / "mine.py"
    file.write_text("\n".join(["def mine(inputs):", *lines]) + "\n", "utf-8")
    return f"{file}:mine"


@pytest.mark.slow
def test_our_wrench_passed_on_gives_our_flight(tmp_path: Path) -> None:
    named = _written(tmp_path, "    return inputs.wrench")
    own = fly(load_scenario("paper_5_free", {**KEYS, "plugins.controller": named}))
    ours = fly(load_scenario("paper_5_free", KEYS))
    assert own.track.odometry.tobytes() == ours.track.odometry.tobytes()
    assert own.track.wrench.tobytes() == ours.track.wrench.tobytes()


def test_the_example_holds_a_vehicle_at_its_command() -> None:
    scenario = load_scenario("paper_5_free", {**KEYS, "plugins.controller": SOFTER})
    config = agent_config(scenario, 2)
    level = np.zeros(13)
    level[6] = 1.0
    found = load_controller(SOFTER).wrench(1.0, 0.01, level, np.zeros(4), np.zeros(6), config)
    weight = config.controller.nominal.mass * config.controller.gravity
    np.testing.assert_allclose(found, [0.0, 0.0, weight, 0.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("line", "match"),
    [
        ("    return 1.0, 2.0", r"mine\.py:1: mine: returned .*expected force .* six numbers"),
        ("    return inputs.gone", r"mine\.py:2: mine: AttributeError"),
    ],
)
def test_a_wrong_controller_is_named(tmp_path: Path, line: str, match: str) -> None:
    named = _written(tmp_path, line)
    with pytest.raises(UserFileError, match=match):
        fly(load_scenario("paper_5_free", {**KEYS, "plugins.controller": named}))
