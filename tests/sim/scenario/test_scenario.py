"""A right scenario file: what is read from it and what every UAV gets of it."""

from pathlib import Path

import numpy as np
import pytest

from ptnsbc_core.types import AVOIDANCE_OFF, PLANT_RIGID_BODY, PROFILE_PAPER, PROFILE_SOFT
from ptnsbc_sim.plants.build import plant_config
from ptnsbc_sim.scenario import ScenarioError, agent_config, load_scenario, scenario_from_text
from ptnsbc_sim.scenario.gains import gain_defaults
from ptnsbc_sim.scenario.model import ScenarioFile

PAPER = Path(__file__).resolve().parents[3] / "scenarios" / "paper_5.yaml"


def test_by_name_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_scenario("paper_5") == load_scenario(PAPER)


def test_by_name_with_suffix_here_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_scenario("paper_5.yaml").name == "paper_5"
    (tmp_path / "paper_5.yaml").write_text("extends: paper_5_free\nname: mine\n")
    assert load_scenario("paper_5.yaml").name == "mine"
    assert load_scenario("paper_5").name == "paper_5"


def test_attributes_of_the_paper() -> None:
    scenario = load_scenario(PAPER)
    assert scenario.uav_ids == (1, 2, 3, 4, 5)
    assert (
        scenario.leader.id,
        scenario.communication.parent(1),
        scenario.communication.parent(4),
    ) == (1, None, 3)
    assert scenario.topology.neighbours.get(3, ()) == (2, 4)
    assert scenario.topology.neighbours.get(1, ()) == ()
    assert 5 in scenario.topology.pinned
    assert (scenario.timing.dt_ns, scenario.near_every, scenario.timing.ticks) == (
        10_000_000,
        5,
        6000,
    )
    assert scenario.topology.lambda_min == pytest.approx(1.0)
    np.testing.assert_array_equal(scenario.uav(5).position, [2, -1, 1])
    assert [obstacle.name for obstacle in scenario.world.bodies] == ["O1", "O2"]
    assert scenario.text == PAPER.read_text(encoding="utf-8")


def test_disturbance_of_table_2() -> None:
    plant, t = plant_config(load_scenario(PAPER), 3), 0.7
    value = plant.amplitude * np.sin(t + np.array(plant.phase)) + plant.offset
    expected = [0.3 * np.cos(t), 0.1 * np.sin(t), 0.4 * np.sin(t)]
    np.testing.assert_allclose(value[:3], expected, atol=1e-15)


def test_constant_disturbance_as_number_and_as_text() -> None:
    overrides = {"uavs[0].disturbance_m_s2": [0.2, "-0.1", "0.3 sin"]}
    plant = plant_config(load_scenario(PAPER, overrides), 1)
    np.testing.assert_array_equal(plant.offset[:3], [0.2, -0.1, 0])
    np.testing.assert_array_equal(plant.amplitude[:3], [0, 0, 0.3])


def test_a_value_may_repeat_its_unit() -> None:
    overrides = {
        "gains.formation.deadline_s": "7.5 s",
        "world.gravity_m_s2": "3.7 m/s²",
        "timing.control_hz": "200 Hz",
        "timing.physics_hz": "1000 hz",
        "plant.inertia_kg_m2": ["0.02 kg m^2", "0.02 kg*m2", 0.03],
        "uavs[1].position_m": ["-1 m", -1, "1e0 m"],
    }
    scenario = load_scenario(PAPER, overrides)
    assert scenario.gains.formation.deadline_s == 7.5
    assert scenario.world.gravity_m_s2 == 3.7
    assert scenario.timing.dt_ns == 5_000_000
    assert scenario.plant.inertia_kg_m2 == (0.02, 0.02, 0.03)


def test_yaml_of_today() -> None:
    """`off` is a word, 1e-3 a number and 010 ten: not so in the YAML of 2005."""
    text = PAPER.read_text(encoding="utf-8")
    text = text.replace("avoidance: set_based", "avoidance: off").replace(
        "stale_s: 0.5", "stale_s: 5e-1"
    )
    scenario = scenario_from_text(text.replace("seed: 1 ", "seed: 010 "))
    assert agent_config(scenario, 2).clearance.rule == AVOIDANCE_OFF
    assert scenario.communication.stale_s == 0.5
    assert scenario.seed == 10


def test_text_loads_again_to_the_same_scenario() -> None:
    overrides = {
        "formation.task": "parent_angle",
        "formation.avoidance": "off",
        "plant.kind": "rigid_body_6dof",
        "gains.profile": "paper",
        "gains.formation.residual": 1e-5,
        "seed": 7,
        "timing.duration_s": None,
    }
    scenario = load_scenario("paper_5_free", overrides)
    again = scenario_from_text(scenario.text)
    assert again == scenario
    assert again.text == scenario.text
    assert scenario.timing.duration_s == 60


def test_free_flight_differs_from_the_paper_by_its_obstacles_only() -> None:
    free, paper = load_scenario("paper_5_free"), load_scenario("paper_5")
    assert free.world.bodies == ()
    for key in set(ScenarioFile.model_fields) - {"name", "description", "world"}:
        assert getattr(free, key) == getattr(paper, key)


def test_extends_merges_mappings_replaces_lists_and_null_removes(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("extends: paper_5\nname: a\nworld: {gravity_m_s2: 9.8}\n")
    (tmp_path / "b.yaml").write_text(
        "extends: a\nname: b\nworld: {obstacles: null}\ncommunication: {leader_links: [2, 3, 5]}\n"
    )
    scenario = load_scenario(tmp_path / "b.yaml")
    assert scenario.world.gravity_m_s2 == 9.8
    assert scenario.world.bodies == ()
    assert scenario.topology.pinned == {2, 3, 5}


def test_extends_in_a_circle(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("extends: a\n")
    with pytest.raises(Exception, match="circle"):
        load_scenario(tmp_path / "a.yaml")


def test_gains_may_be_left_out_but_for_the_deadline() -> None:
    scenario = load_scenario(PAPER, {"gains": {"formation": {"deadline_s": 4}}})
    assert scenario.gains.formation.deadline_s == 4
    assert scenario.gains.formation.residual == gain_defaults("quadrotor")["formation"]["residual"]


def test_a_loop_takes_the_profile_of_the_scenario_unless_it_has_its_own() -> None:
    config = agent_config(load_scenario(PAPER, {"gains.formation.profile": "paper"}), 2)
    assert config.formation.profile == PROFILE_PAPER
    assert config.attitude.profile == PROFILE_SOFT


def test_table_1_of_the_paper_reaches_the_controller() -> None:
    scenario = load_scenario(PAPER, {"plant.kind": "rigid_body_6dof"})
    controller = agent_config(scenario, 2).controller
    np.testing.assert_allclose(controller.adaptation, [0.4, 0.4])
    assert controller.bound_rate == pytest.approx(2.5)
    assert controller.nominal == (1.2, (0.019, 0.019, 0.021))


def test_rigid_body_needs_no_quadrotor_limits() -> None:
    scenario = load_scenario(
        PAPER, {"plant": {"kind": "rigid_body_6dof", "mass_kg": 1, "inertia_kg_m2": [1, 1, 1]}}
    )
    assert agent_config(scenario, 2).controller.plant == PLANT_RIGID_BODY


@pytest.mark.parametrize("task", ["distance_angles", "parent_angle", "relative_position"])
def test_every_uav_has_the_same_types(task: str) -> None:
    """numba compiles by type: a second type would double the start-up of a fleet."""
    numba = pytest.importorskip("numba")
    scenario = load_scenario(PAPER, {"formation.task": task})
    assert len({str(numba.typeof(agent_config(scenario, uav))) for uav in scenario.uav_ids}) == 1


def test_row_scale_is_the_horizontal_arm() -> None:
    overrides = {"formation.offsets_m.3": [-0.6, -1.2, 0.7]}
    for task, expected in (("distance_angles", (1, 1, 1)), ("parent_angle", (1, 1, 0))):
        scenario = load_scenario(PAPER, {**overrides, "formation.task": task})
        arm = np.hypot(0.6, 1.2)
        scale = agent_config(scenario, 3).row_scale
        np.testing.assert_allclose(scale, [1, arm, arm if expected[2] else 1])


def test_only_the_child_of_the_leader_has_a_heading_anchor() -> None:
    scenario = load_scenario(PAPER)
    np.testing.assert_array_equal(agent_config(scenario, 2).anchor, [2, 0, 0])
    np.testing.assert_array_equal(agent_config(scenario, 3).anchor, [0, 0, 0])


def test_line_trajectory() -> None:
    line = {"kind": "line", "position_m": [1, 2, 3], "velocity_m_s": [4, 5, 6], "yaw_rad": 0.5}
    config = agent_config(load_scenario(PAPER, {"leader.trajectory": line}), 1)
    assert config.trajectory.numbers == (1, 1, 2, 3, 4, 5, 6, 0.5)


UNLIKE = {
    "uavs[1].mass_kg": 2.0,
    "uavs[1].inertia_kg_m2": [0.04, 0.04, 0.05],
    "uavs[1].max_force_n": 30.0,
    "uavs[1].max_speed_m_s": 3.0,
    "uavs[1].keep_out_m": 1.1,
    "uavs[2].max_tilt_rad": 0.35,
    "uavs[2].drag_1_s": 0.3,
    "uavs[2].max_torque_nm": [1.0, 1.0, 0.2],
}


def test_a_uav_has_its_own_vehicle() -> None:
    scenario = load_scenario("paper_5", UNLIKE)
    heavy, weak, other = (agent_config(scenario, uav) for uav in (2, 3, 4))
    assert heavy.controller.nominal == (2.0, (0.04, 0.04, 0.05))
    assert (heavy.controller.max_thrust, heavy.filter.max_speed) == (30.0, 3.0)
    assert (weak.controller.max_tilt, weak.controller.max_torque) == (0.35, (1.0, 1.0, 0.2))
    alike = agent_config(load_scenario("paper_5"), 4)
    assert (other.controller, other.filter) == (alike.controller, alike.filter)
    plants = [plant_config(scenario, uav) for uav in (2, 3)]
    assert [(one.mass, one.max_thrust, one.drag) for one in plants] == [
        (2.0, 30.0, 0.1),
        (1.2, 25.9, 0.3),
    ]


def test_true_mass_and_inertia_are_scales_of_the_uavs_own() -> None:
    scenario = load_scenario("paper_5", {**UNLIKE, "uavs[1].mass_scale": 1.1})
    assert plant_config(scenario, 2).mass == pytest.approx(2.2)
    assert agent_config(scenario, 2).controller.nominal.mass == 2.0


def test_near_what_moves_all_count_on_the_weakest() -> None:
    scenario = load_scenario("paper_5", UNLIKE)
    own = {uav: agent_config(scenario, uav).clearance.deceleration for uav in scenario.uav_ids}
    assert own[3] == pytest.approx(9.81 * np.tan(0.35))
    assert own[2] == pytest.approx(30.0 / 2.0 - 9.81)
    assert own[1] == agent_config(load_scenario("paper_5"), 1).clearance.deceleration
    weakest = {agent_config(scenario, uav).clearance.weakest for uav in scenario.uav_ids}
    assert weakest == {min(own.values())}


def test_two_stay_the_mean_of_their_keep_outs_apart() -> None:
    scenario = load_scenario("paper_5", UNLIKE)
    assert scenario.keep_out_between(2, 3) == pytest.approx(0.8)
    assert scenario.keep_out_between(1, 3) == 0.5
    assert scenario.widest_keep_out_m == pytest.approx(0.8)


def test_a_keep_out_is_no_lower_than_it_is_wide() -> None:
    scenario = load_scenario("paper_5", {"formation.uav_keep_out_above_m": 1.5})
    assert scenario.formation.keep_out_scale.tolist() == [1.0, 1.0, pytest.approx(1 / 3)]
    assert scenario.highest_keep_out_m == 1.5
    low = r"formation\.uav_keep_out_above_m: 0\.4: expected at least formation\.uav_keep_out_m \(0\.5 m\)"
    with pytest.raises(ScenarioError, match=low):
        load_scenario("paper_5", {"formation.uav_keep_out_above_m": 0.4})


def test_the_common_deadline_counts_on_the_weakest() -> None:
    shortest = load_scenario(
        "paper_5", {"gains.formation.deadline_s": "auto"}
    ).gains.formation.deadline_s
    for own in ({"uavs[3].max_speed_m_s": 2.0}, {"uavs[3].max_tilt_rad": 0.1}):
        changes = {"gains.formation.deadline_s": "auto", **own}
        assert load_scenario("paper_5", changes).gains.formation.deadline_s > 1.3 * shortest


def test_a_vehicle_that_cannot_hover_is_named() -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario("paper_5", {"uavs[1].mass_kg": 3.0})
    assert "expected more than the weight of UAV 2, 29.4 N" in str(caught.value)
    with pytest.raises(ScenarioError) as caught:
        load_scenario("paper_5", {"uavs[1].max_force_n": 9.0})
    assert "uavs[1].max_force_n: 9: expected more than the weight" in str(caught.value)
