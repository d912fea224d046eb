"""Plants, disturbances and sensors of the user: ours made again gives our flight, and the world gives the same bits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ptnsbc_sim.plugins.loader import PluginError
from ptnsbc_sim.scenario import ScenarioError, load_scenario, scenario_from_text
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.world import World

EXAMPLES = Path(__file__).parents[3] / "examples" / "plugins"
KEYS = {"timing.duration_s": 1.0, "plant.kind": "quadrotor"}
OF_WORLD = {
    "plugins.plant": f"{EXAMPLES}/square_drag.py:square_drag",
    "plugins.disturbance": f"{EXAMPLES}/thermal.py:thermal",
    "plugins.sensor": f"{EXAMPLES}/camera.py:camera",
}


def _written(folder: Path, *lines: str) -> str:
    file = folder / "mine.py"
    file.write_text("\n".join(["import numpy as np", "def mine(inputs):", *lines]) + "\n", "utf-8")
    return f"{file}:mine"


def test_a_disturbance_of_zero_changes_no_bit(tmp_path: Path) -> None:
    named = _written(tmp_path, "    return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0")
    own = fly(load_scenario("paper_5_free", {**KEYS, "plugins.disturbance": named}))
    assert (
        own.track.odometry.tobytes()
        == fly(load_scenario("paper_5_free", KEYS)).track.odometry.tobytes()
    )


def test_a_disturbance_adds_its_acceleration_and_is_drawn_from_the_seed(tmp_path: Path) -> None:
    named = _written(tmp_path, "    return inputs.samples")
    one = load_scenario("paper_5_free", {**KEYS, "plugins.disturbance": named})
    first, again, other = (fly(s).track.odometry for s in (one, one, one.with_(seed=9)))
    assert first.tobytes() == again.tobytes() != other.tobytes()


@pytest.mark.slow
def test_our_plant_made_again_flies_as_ours(tmp_path: Path) -> None:
    """`square_drag` without drag is our quadrotor: sums are rounded in another order."""
    text = (EXAMPLES / "square_drag.py").read_text("utf-8").replace("0.05", "0.0")
    (tmp_path / "plain.py").write_text(text, "utf-8")
    keys = {**KEYS, "plant.quadrotor.drag_1_s": 0.0}
    ours = fly(load_scenario("paper_5_free", keys)).track.odometry
    named = f"{tmp_path}/plain.py:square_drag"
    own = fly(load_scenario("paper_5_free", {**keys, "plugins.plant": named})).track.odometry
    np.testing.assert_allclose(own, ours, atol=1e-7)


@pytest.mark.slow
def test_a_sensor_sees_what_it_returns(tmp_path: Path) -> None:
    blind = _written(tmp_path, "    return np.zeros((0, 8))")
    seen = fly(load_scenario("paper_5_free", {**KEYS, "plugins.sensor": blind}))
    assert seen.near(0, 1).shape == (0, 8)
    near = fly(load_scenario("paper_5_free", {**KEYS, **OF_WORLD}))
    full = fly(load_scenario("paper_5_free", KEYS))
    rows = {tuple(row) for row in full.near(0, 2)}
    forward = near.near(0, 2)
    assert len(forward) < len(rows) and all(tuple(row) in rows for row in forward)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["paper_5_free", "experiment_4"])
def test_the_world_gives_the_bits_of_the_headless_flight(scenario: str) -> None:
    one = load_scenario(scenario, {**KEYS, "timing.duration_s": 0.4, **OF_WORLD})
    flight = fly(one)
    world = World(one)
    for tick in range(one.timing.ticks - 1):
        for row, uav in enumerate(one.uav_ids):
            assert world.odometry(uav).tobytes() == flight.track.odometry[tick, row].tobytes()
            if tick % one.near_every == 0:
                assert world.near(uav).tobytes() == flight.near(tick, row).tobytes()
        world.step({uav: flight.track.wrench[tick, row] for row, uav in enumerate(one.uav_ids)})


@pytest.mark.parametrize(
    ("kind", "line", "match"),
    [
        (
            "disturbance",
            "    return 1.0, 2.0",
            r"mine\.py:2: mine: returned .*expected six numbers",
        ),
        ("plant", "    return np.zeros(16)", r"mine\.py:2: mine: returned .*expected 17 numbers"),
        ("sensor", "    return np.zeros((50, 8))", r"mine\.py:2: mine: .*at most 4 rows of 8"),
        ("sensor", "    return inputs.objects[99]", r"mine\.py:\d: mine: "),
    ],
)
def test_a_wrong_function_is_named(tmp_path: Path, kind: str, line: str, match: str) -> None:
    named = _written(tmp_path, line)
    with pytest.raises(PluginError, match=match):
        fly(load_scenario("paper_5_free", {**KEYS, f"plugins.{kind}": named}))


def test_what_a_bag_names_is_not_executed(tmp_path: Path) -> None:
    mark = tmp_path / "executed"
    named = _written(tmp_path, f"    return open({str(mark)!r}, 'w')")
    for kind in ("task", "controller", "plant", "disturbance", "sensor"):
        text = load_scenario("paper_5_free", {**KEYS, f"plugins.{kind}": named}).text
        carried = scenario_from_text(text, complete=True)
        assert getattr(carried.plugins, kind) == "mine.py:mine"
        other = "controller" if kind == "sensor" else "sensor"
        changed = carried.with_({f"plugins.{other}": named, "timing.duration_s": 0.5})
        assert getattr(changed.plugins, kind) == "mine.py:mine"
        with pytest.raises(PluginError, match=f"{kind}: .*a bag names a {kind}"):
            fly(carried)
    assert not mark.exists()


def test_a_plant_has_the_state_of_a_quadrotor(tmp_path: Path) -> None:
    keys = {"plugins.plant": _written(tmp_path, "    return 0"), "plant.kind": "rigid_body_6dof"}
    with pytest.raises(ScenarioError, match=r"expected plant\.kind: quadrotor"):
        load_scenario("paper_5_free", keys)


@pytest.mark.parametrize(
    ("named", "match"),
    [
        ("mine.txt:mine", r"plugins\.sensor: .*expected FILE\.py:NAME"),
        (
            "mine",
            r"sensor: mine: expected FILE\.py:NAME, or the name of an entry point sensor\.NAME",
        ),
    ],
)
def test_a_name_of_no_function_is_refused(named: str, match: str) -> None:
    with pytest.raises(ScenarioError, match=match):
        load_scenario("paper_5_free", {"plugins.sensor": named})
