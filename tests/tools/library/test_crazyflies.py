"""A scenario by the crazyflies.yaml of a laboratory: its names and places, and what is none."""

import pytest

from ptnsbc_sim.scenario import ScenarioError, load_scenario
from ptnsbc_tools.library.flying import check
from ptnsbc_tools.library.new_scenario import new

ROBOTS = """
fileversion: 3
robots:
  cf231: {enabled: true, uri: radio://0/80/2M/E7E7E7E7E7, initial_position: [0.0, 0.0, 0.0], type: cf21}
  cf5: {enabled: false, initial_position: [0.0, -0.5, 0.0], type: cf21}
  cf6: {enabled: true, initial_position: [0.5, 0.5, 0.0], type: cf21}
  ball: {enabled: true, initial_position: [9.0, 9.0, 0.0], type: tracked}
robot_types: {cf21: {big_quad: false}, tracked: {connection: none}}
"""


def test_the_enabled_crazyflies_fly_from_where_they_stand(tmp_path):
    (tmp_path / "crazyflies.yaml").write_text(ROBOTS)
    made = load_scenario(new(tmp_path / "lab", crazyflies=tmp_path / "crazyflies.yaml"))
    assert (made.name, made.uav_ids) == ("lab", (1, 2))
    assert made.uav(2).position.tolist() == [0.5, 0.5, 0.0]
    assert [made.ros.vehicle(uav).output for uav in made.uav_ids] == [
        "/cf231/cmd_full_state",
        "/cf6/cmd_full_state",
    ]
    findings = check(made, dry_runs=0).findings
    assert not [one for one in findings if one.severity == "error"]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("robots: [", "crazyflies.yaml: "),
        ("robots: {}", "crazyflies.yaml: 0 Crazyflies are enabled: expected 2 or more"),
        ("all: {}", "crazyflies.yaml: expected robots, each with enabled and initial_position"),
        ("robots: {a: {enabled: true, initial_position: [0, 0]}}", "expected robots, each with"),
        ("robots: {a: {enabled: true, initial_position: [0, 0, x]}}", "expected robots, each"),
    ],
)
def test_another_file_is_refused_and_nothing_written(tmp_path, text, why):
    (tmp_path / "crazyflies.yaml").write_text(text)
    with pytest.raises(ScenarioError, match=why):
        new(tmp_path / "lab", crazyflies=tmp_path / "crazyflies.yaml")
    assert not (tmp_path / "lab.yaml").exists()
