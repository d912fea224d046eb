"""One test per kind of mistake in a scenario file: one line, the exact key path, the way out."""

from pathlib import Path
from typing import Any

import pytest

from ptnsbc_core.errors import FormationError, GainError, PtnsbcError, TopologyError
from ptnsbc_sim.scenario import ScenarioError, agent_config, load_scenario, scenario_from_text

PAPER = Path(__file__).resolve().parents[3] / "scenarios" / "paper_5.yaml"


def refusal(old: str, new: str, *, count: int = 1) -> str:
    """The message for paper_5 with one piece of text exchanged."""
    text = PAPER.read_text(encoding="utf-8")
    assert old in text
    with pytest.raises(PtnsbcError) as caught:
        scenario_from_text(text.replace(old, new, count), source="file.yaml")
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("file.yaml: ")
    return message


@pytest.mark.parametrize(
    ("old", "new", "path", "hint"),
    [
        # a key that does not exist
        ("radius_m: 5", "radious_m: 5", "leader.trajectory.radious_m: ", '"radius_m"'),
        ("stale_s: 0.5", "stale: 0.5", "communication.stale: ", '"stale_s"'),
        ("seed: 1 ", "sead: 1 ", "sead: unknown key", '"seed"'),
        ("feed_forward: true", "feedforward: true", "gains.estimator.feedforward: ", "_forward"),
        # a unit
        ("deadline_s: 5,", 'deadline_s: "5 m",', 'gains.formation.deadline_s: "5 m": ', "unit s"),
        (
            "position_m: [-1, 0, 1]",
            'position_m: [-1, "0 s", 1]',
            'uavs[2].position_m[1]: "0 s": ',
            "unit m",
        ),
        ("mass_kg: 1.2", "mass_kg: heavy", 'plant.mass_kg: "heavy": ', "number in kg"),
        (
            "3: [-0.6, -1.2, 0]",
            '3: [-0.6, "-1.2 ft", 0]',
            'formation.offsets_m.3[1]: "-1.2 ft": ',
            "unit m",
        ),
        # a type
        ("mass_kg: 1.2", "mass_kg: true", "plant.mass_kg: True: ", "number in kg"),
        ("control_hz: 100", "control_hz: 99.5", "timing.control_hz: 99.5: ", "whole number"),
        ("seed: 1 ", "seed: one ", 'seed: "one": ', "whole number"),
        ("feed_forward: true", "feed_forward: 1", "gains.estimator.feed_forward: 1: ", "true or"),
        ("range_m: 4", "range_m: .nan", "sensor.range_m: nan: ", "finite"),
        ("range_m: 4", "range_m: .inf", "sensor.range_m: inf: ", "finite"),
        ("name: paper_5", "name: 'paper 5'", 'name: "paper 5": ', "letters"),
        # a range
        ("mass_kg: 1.2", "mass_kg: -1.2", "plant.mass_kg: -1.2: ", "> 0"),
        (
            "deadline_s: 5, residual: ",
            "deadline_s: 5, residual: -",
            "gains.formation.residual: -",
            "> 0",
        ),
        (
            "deadline_s: 5, residual",
            "deadline_s: 0, residual",
            "gains.formation.deadline_s: 0: ",
            "> 0",
        ),
        ("motor_lag_s: 0.02", "motor_lag_s: 0", "plant.quadrotor.motor_lag_s: 0: ", "> 0"),
        ("    motor_lag_s: 0.02\n", "", "plant.quadrotor.motor_lag_s: missing", "number in s"),
        ("mass_kg: 1.2", "mass_kg: 1e13", "plant.mass_kg: 10000000000000.0: ", "<= 1e+12"),
        ("mass_kg: 1.2", "mass_kg: 1e13 kg", "plant.mass_kg: 10000000000000: ", "<= 1e+12"),
        (
            "3: [-0.6, -1.2, 0]",
            "3: [-0.6, -1e300, 0]",
            "formation.offsets_m.3[1]: -1e+300: ",
            ">= -1e+12",
        ),
        # a list of the wrong length
        (
            "position_m: [2, -1, 1]",
            "position_m: [2, -1]",
            "uavs[4].position_m: [2, -1]: ",
            "three numbers",
        ),
        # a word
        ("kind: quadrotor", "kind: quadroter", 'plant.kind: "quadroter": ', '"quadrotor"'),
        ("profile: soft", "profile: sofd", 'gains.profile: "sofd": ', '"soft"'),
        ("kind: circle", "kind: circel", 'leader.trajectory.kind: "circel": ', '"circle"'),
        ("kind: circle, ", "", "leader.trajectory.kind: missing", "this key"),
        # a disturbance
        (
            '["0.3 cos", "0.1 sin", "0.4 sin"]',
            '["0.3 cos", "0.1 tan", "0.4 sin"]',
            'uavs[2].disturbance_m_s2[1]: "0.1 tan": ',
            "0.2 cos",
        ),
        (
            '["0.3 cos", "0.1 sin", "0.4 sin"]',
            '["0.3 cos", "1e13 sin", "0.4 sin"]',
            'uavs[2].disturbance_m_s2[1]: "1e13 sin": ',
            "-1e+12 to 1e+12",
        ),
        # something missing
        ("  mass_kg: 1.2", "  # no mass", "plant.mass_kg: missing", "number in kg"),
        ("deadline_s: 5, ", "", "gains.formation.deadline_s: missing", "number in s"),
        ("    3: [-0.6, -1.2, 0]\n", "", "formation.offsets_m.3: missing", "offset"),
        # ids
        ("  - id: 3\n", "  - id: 2\n", "uavs[2].id: 2: duplicate of uavs[1].id", "own id"),
        ("  - id: 5\n", "  - id: 6\n", "communication.tree.5: 5: no such UAV", "under uavs: 1"),
        ("5: [1.2, -2.4, 0]", "9: [1.2, -2.4, 0]", "formation.offsets_m.9: no such UAV", "2, 3"),
        ("5: 4}", "5: 7}", "communication.tree.5: 7: no such UAV", "1, 2, 3, 4, 5"),
        (
            "leader_links: [2, 3, 4, 5]",
            "leader_links: [2, 3, 8]",
            "communication.leader_links[2]: 8: ",
            "no such UAV",
        ),
        (
            "[[2, 3], [3, 4], [4, 5]]",
            "[[2, 3], [3, 9]]",
            "communication.estimator_edges[1][1]: 9: ",
            "no such UAV",
        ),
        ("  id: 1\n", "  id: 7\n", "leader.id: 7: ", "expected one of"),
        ("name: O2", "name: O1", 'world.obstacles[1].name: "O1": duplicate', "own name"),
        # rates that do not fit together
        ("physics_hz: 500", "physics_hz: 130", "timing.physics_hz: 130: ", "multiple"),
        ("rate_hz: 20", "rate_hz: 30", "sensor.rate_hz: 30: ", "divisor"),
        ("control_hz: 100", "control_hz: 35", "timing.control_hz: 35: ", "nanoseconds"),
        ("max_thrust_n: 25.9", "max_thrust_n: 9", "plant.quadrotor.max_thrust_n: 9: ", "hover"),
    ],
)
def test_names_key_value_and_way_out(old: str, new: str, path: str, hint: str) -> None:
    message = refusal(old, new)
    assert message.startswith(f"file.yaml: {path}"), message
    assert hint in message


def test_yaml_syntax_has_line_and_column() -> None:
    message = refusal("mass_kg: 1.2 ", "mass_kg: [1.2 ")
    assert ": line " in message
    assert ", column " in message


def test_duplicate_key_is_refused_at_its_line() -> None:
    with pytest.raises(ScenarioError, match='line 3, column 1: duplicate key "name", keep one'):
        scenario_from_text("name: x\nseed: 1\nname: y\n")


@pytest.mark.parametrize(
    "text", ["", "- 1\n- 2\n", "just text", "? [1, 2]\n: 3\n", "a: &x 1\nb: *x\n"]
)
def test_text_that_is_no_mapping(text: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        scenario_from_text(text)
    assert "expected" in str(caught.value) or "not supported" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_block_of_the_wrong_type() -> None:
    with pytest.raises(ScenarioError, match="sensor: 4: expected a mapping"):
        load_scenario(PAPER, {"sensor": 4})
    with pytest.raises(ScenarioError, match="gains: 4: expected a mapping"):
        load_scenario(PAPER, {"gains": 4})


def test_cycle_in_the_tree() -> None:
    message = refusal("{2: 1, 3: 2, 4: 3, 5: 4}", "{2: 1, 3: 4, 4: 3, 5: 4}")
    assert message.startswith("file.yaml: communication.tree: cycle")


def test_cycle_is_a_topology_error() -> None:
    with pytest.raises(TopologyError):
        load_scenario(PAPER, {"communication.tree.3": 4})


def test_estimator_that_its_step_cannot_follow() -> None:
    with pytest.raises(GainError) as caught:
        load_scenario(PAPER, {"gains.estimator.boundary": 0.1})
    message = str(caught.value)
    assert "gains.estimator: " in message
    assert "expected < 2" in message
    assert "raise gains.estimator.boundary" in message


def test_angles_have_no_meaning_above_the_parent() -> None:
    scenario = load_scenario(PAPER, {"formation.offsets_m.3": [-1.2, -2.4, 1]})
    with pytest.raises(
        FormationError, match=r"formation\.offsets_m\.3: 0 m beside its parent UAV 2"
    ):
        agent_config(scenario, 3)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("paper_6", 'did you mean "paper_5"'),
        ("nowhere/paper_5.yaml", "no such scenario file"),
        ("zzz", "expected one of: "),
        ("paper_6.yaml", 'no such scenario file; did you mean "paper_5"'),
        ("zzz.yaml", "no such scenario file; expected one, or a name"),
        ("scenarios", "scenarios: a folder"),
        ("", '"": expected the name or the file'),
    ],
)
def test_scenario_that_is_not_there(name: str, expected: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(name)
    assert expected in str(caught.value)


def test_file_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(b"name: \xff\xfe")
    with pytest.raises(ScenarioError, match="byte 6: expected UTF-8"):
        load_scenario(path)


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ({"gains.formaton.scale": 2}, 'gains.formaton: unknown key: did you mean "formation"'),
        ({"deadline_s": 6}, "deadline_s: unknown key: did you mean gains.formation.deadline_s or "),
        ({"wind": 1}, "wind: unknown key: did you mean world.wind_m_s?"),
        ({"gains.kapa": 1}, "gains.kapa: unknown key: did you mean gains.formation.kappa_1_s or "),
        ({"uavs[9].position_m": [0, 0, 0]}, "uavs[9].position_m: 9: expected an index below 5"),
        ({"seed.x.y": 1}, "nothing below this key"),
    ],
)
def test_wrong_override(overrides: dict[str, Any], expected: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(PAPER, overrides)
    assert expected in str(caught.value)
