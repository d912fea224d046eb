"""Flights with functions of the user: a task of ours written again, and all kinds at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ptnsbc_sim.plugins.loader import PluginError
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.swarm import fly

EXAMPLES = Path(__file__).parents[3] / "examples" / "plugins"


LAWS = EXAMPLES.parent / "laws"


@pytest.mark.slow
@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_a_compiled_law_flies_as_the_same_one_between_kernels(tmp_path: Path, loss: float) -> None:
    """One that numba cannot compile: of another text and the same numbers."""
    keys = {"timing.duration_s": 0.5, "communication.loss": loss}
    text = (LAWS / "integral.py").read_text("utf-8")
    (tmp_path / "slow.py").write_text(
        "import json\n" + text.replace("    now =", "    json.loads('1')\n    now ="), "utf-8"
    )
    compiled, slow = (
        fly(load_scenario("paper_5_free", {**keys, "law": f"{folder}:integral"})).track
        for folder in (LAWS / "integral.py", tmp_path / "slow.py")
    )
    assert compiled.odometry.tobytes() == slow.odometry.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "match"),
    [
        ("if early < 1: raise ValueError('no way')", r"mine\.py:4: law: ValueError: no way"),
        ("x = 1.0 / early", r"mine\.py:4: law: ZeroDivisionError"),
        ("x = 0.0 if early else np.inf", r"returned \(inf, 0, 0\) at t = 0\.100 s: "),
    ],
)
def test_a_law_that_fails_in_the_middle_of_a_flight_is_named(
    tmp_path: Path, line: str, match: str
) -> None:
    lines = "    x, early = 0.0, int(inputs.t < 0.095)", f"    {line}", "    return (x, 0.0, 0.0)"
    file = tmp_path / "mine.py"
    file.write_text("\n".join(["import numpy as np", "def law(inputs):", *lines]) + "\n", "utf-8")
    with pytest.raises(PluginError, match=match):
        fly(load_scenario("paper_5_free", {"timing.duration_s": 0.5, "law": f"{file}:law"}))


@pytest.mark.slow
def test_a_uav_that_begins_anew_has_the_first_memory(tmp_path: Path) -> None:
    """The law refuses to remember a tick that is long ago."""
    file = tmp_path / "mine.py"
    file.write_text(
        "def law(inputs):\n"
        "    if inputs.memory[0] >= 0.0 and inputs.t - inputs.memory[0] > 0.05:\n"
        "        raise ValueError\n"
        "    return inputs.velocities[0], (inputs.t,)\n"
        "law.memory = (-1.0,)\n",
        "utf-8",
    )
    restart = {"kind": "restart", "uav": 3, "at_s": 0.2, "duration_s": 0.2}
    keys = {"timing.duration_s": 0.6, "law": f"{file}:law", "faults": [restart]}
    flown = fly(load_scenario("paper_5_free", keys)).track.velocity[:, 2]
    assert flown[19].any() and not flown[30].any() and flown[59].any()


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
