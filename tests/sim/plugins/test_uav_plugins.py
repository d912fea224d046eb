"""Plug-ins that a UAV flies by, of every hook, of a file or of an installed package; the leader has no law."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_core.kernel import COMPILED
from ptnsbc_sim.plugins.hooks import HOOKS, LawInputs
from ptnsbc_sim.plugins.loader import PluginError
from ptnsbc_sim.plugins.uav_plugins import Heard, UavLaw, UavPlugins, law_senders
from ptnsbc_sim.scenario import Scenario, agent_config, load_scenario
from ptnsbc_sim.swarm import fly

EXAMPLES = Path(__file__).parents[3] / "examples" / "plugins"
LAWS = EXAMPLES.parent / "laws"
CONSENSUS = f"{LAWS}/consensus.py:consensus"
PROPORTIONAL = f"{EXAMPLES / 'proportional.py'}:proportional"
FLOWN = {"timing.duration_s": 1.0, "plant.kind": "quadrotor"}


def _written(folder: Path, *lines: str) -> str:
    file = folder / "mine.py"
    file.write_text("\n".join(["def mine(inputs):", *lines]) + "\n", "utf-8")
    return f"{file}:mine"


def _law_of(scenario: Scenario, uav: int) -> UavLaw:
    law = UavPlugins.of(scenario, uav).law
    assert law is not None
    return law


def _velocity(
    law: UavLaw, t: float, own: np.ndarray, heard: list[Heard]
) -> tuple[tuple[float, ...], np.ndarray]:
    return law.velocity(t, t, own, heard, np.zeros((0, 7)), np.array(law.law.memory))


def test_by_the_part_of_the_uav() -> None:
    scenario = load_scenario(EXAMPLES / "all.yaml")
    leader, follower = (UavPlugins.of(scenario, uav) for uav in (1, 2))
    assert (leader.task, leader.law, follower.law) == (None, None, None)
    assert follower.task is not None and follower.controller is leader.controller is not None
    assert UavPlugins.of(load_scenario("paper_5_free"), 2) == UavPlugins()


def test_every_hook_has_an_example() -> None:
    assert set(KINDS) == set(HOOKS)


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
@pytest.mark.parametrize("kind", ["law", "plant"])
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
    [
        pytest.param(kind, marks=[pytest.mark.slow] * (kind in ("law", "task", "controller")))
        for kind in KINDS
    ],
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
    why = "4: numba does not know loads: json.loads('1')"
    if kind == "task":
        why = "3: numba cannot compile it: def mine(*inputs):"
    assert not COMPILED or f"mine.py:{why}: mine is interpreted, " in said


def test_in_formation_consensus_keeps_the_common_velocity() -> None:
    scenario = load_scenario("paper_5_free", {"law": CONSENSUS})
    leader, velocity = np.array([1.0, 2.0, 8.0]), np.array([0.3, -0.2, 0.1])

    def state(uav: int) -> np.ndarray:
        return np.concatenate(
            [leader + scenario.offset(uav), [0.0, 0.0, 0.0, 1.0], velocity, np.zeros(3)]
        )

    law = _law_of(scenario, 3)
    senders = law_senders(scenario, 3)
    assert senders == (1, 2, 4)  # leader, parent, and the neighbour above it
    heard = [Heard(uav, state(uav), 0.0) for uav in senders]
    found, _ = _velocity(law, 2.0, state(3), heard)
    np.testing.assert_allclose(found, velocity, atol=1e-12)
    assert _velocity(law, 2.0, state(3), [])[0] == (0.0, 0.0, 0.0)


def test_what_a_law_hears_is_extrapolated_by_it_and_turned_to_the_world() -> None:
    scenario = load_scenario("paper_5_free", {"law": CONSENSUS})
    turned = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    seen: list[LawInputs] = []
    law = _law_of(scenario, 2)
    law.law = replace(law.law, call=lambda inputs: seen.append(inputs) or (0.0, 0.0, 0.0))  # type: ignore[func-returns-value]
    _velocity(law, 0.5, turned, [Heard(1, turned, 0.02)])
    # a half turn about z: the body's x is the world's -x
    np.testing.assert_allclose(seen[0].velocities, [[-1.0, 0.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(seen[0].velocity, [-1.0, 0.0, 0.0], atol=1e-15)
    assert (seen[0].ids.tolist(), seen[0].ages_s.tolist()) == ([1], [0.02])


def test_a_law_is_told_how_the_places_move() -> None:
    """They turn with the leader's heading: as far from it as ever, and at right angles to the way there."""
    keys = {
        "formation.frame": "heading",
        "formation.task": "relative_position",
        "leader.trajectory.heading": "path",
    }
    law = _law_of(load_scenario("paper_5_free", {"law": f"{LAWS}/integral.py:integral", **keys}), 3)
    seen: list[LawInputs] = []
    law.law = replace(law.law, call=lambda inputs: seen.append(inputs) or (np.zeros(3), np.ones(4)))  # type: ignore[func-returns-value]
    level = np.eye(13)[6]
    for t in (20.0, 20.001):
        assert _velocity(law, t, level, [Heard(1, level, 0.0)])[1].tolist() == [1.0] * 4
    first, then = seen
    rate = (then.offset - first.offset) / 0.001
    np.testing.assert_allclose(first.offset_velocity, rate, atol=1e-3)
    assert np.linalg.norm(rate) > 0.01
    np.testing.assert_allclose(first.offsets, 0.0, atol=1e-12)  # the leader's


@pytest.mark.slow
def test_a_law_flies_its_followers_and_leaves_the_leader(tmp_path: Path) -> None:
    named = _written(tmp_path, "    return (0.0, 0.0, 0.2)")
    keys = {"timing.duration_s": 2.0, "formation.avoidance": "off"}
    ours = fly(load_scenario("paper_5_free", keys))
    theirs = fly(load_scenario("paper_5_free", {**keys, "law": named}))
    np.testing.assert_array_equal(theirs.track.odometry[:, 0], ours.track.odometry[:, 0])
    late = theirs.track.velocity[150:, 1:, :3]
    np.testing.assert_allclose(late, np.broadcast_to([0.0, 0.0, 0.2], late.shape), atol=1e-3)
    again = fly(load_scenario("paper_5_free", {**keys, "law": named}))
    assert again.track.odometry.tobytes() == theirs.track.odometry.tobytes()


@pytest.mark.slow
def test_our_wrench_passed_on_gives_our_flight(tmp_path: Path) -> None:
    named = _written(tmp_path, "    return inputs.wrench")
    own = fly(load_scenario("paper_5_free", {**FLOWN, "plugins.controller": named}))
    ours = fly(load_scenario("paper_5_free", FLOWN))
    assert own.track.odometry.tobytes() == ours.track.odometry.tobytes()
    assert own.track.wrench.tobytes() == ours.track.wrench.tobytes()


def test_the_example_holds_a_vehicle_at_its_command() -> None:
    scenario = load_scenario("paper_5_free", {**FLOWN, "plugins.controller": PROPORTIONAL})
    config = agent_config(scenario, 2)
    level = np.zeros(13)
    level[6] = 1.0
    found = UavPlugins.of(scenario, 2).wrench(1.0, 0.01, level, np.zeros(4), np.zeros(6), config)
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
    with pytest.raises(PluginError, match=match):
        fly(load_scenario("paper_5_free", {**FLOWN, "plugins.controller": named}))
