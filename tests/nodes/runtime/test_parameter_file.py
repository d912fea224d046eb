"""A parameter file brings a node the whole scenario, through the parser that ROS has."""

import pytest
import yaml

from ptnsbc_nodes.runtime.parameter_file import parameter_file
from ptnsbc_sim.scenario import available, load_scenario


def test_no_value_is_in_it_twice():
    tree = yaml.safe_load(parameter_file(load_scenario("paper_5")))["/**"]["ros__parameters"]
    text = yaml.safe_load(tree["scenario_text"])
    assert tree["gains"]["formation"]["kappa_1_s"] == 2.2
    assert "gains" not in text
    assert text["formation"].keys() == {"offsets_m", "heading_anchor_m"}
    assert len(text["uavs"]) == 5


@pytest.mark.ros
@pytest.mark.parametrize("name", available())
def test_a_node_reads_the_same_scenario_from_it(ros, tmp_path, name):
    from ptnsbc_nodes.runtime.parameters import SCENARIO, UAV, NodeParameters

    scenario = load_scenario(name)
    file = tmp_path / "params.yaml"
    file.write_text(parameter_file(scenario), encoding="utf-8")
    node = ros.node(
        "controller",
        namespace="/uav2",
        automatically_declare_parameters_from_overrides=True,
        cli_args=["--ros-args", "--params-file", str(file), "-p", "gains.hold.gain_1_s:=0.75"],
    )
    told = NodeParameters(node, (*SCENARIO, UAV))
    told.declare_scenario()
    changed = load_scenario(name, {"gains.hold.gain_1_s": 0.75})
    assert (told.uav, told.scenario.file) == (2, changed.file)


@pytest.mark.ros
@pytest.mark.parametrize(("uav", "gain"), [(1, 0.5), (10, 0.25), (2, 0.75)])
def test_uav1_and_uav10_have_their_own(ros, tmp_path, uav, gain):
    """A name with a digit more is another name, and so is a key with a number in it."""
    from ptnsbc_nodes.runtime.parameters import SCENARIO, UAV, NodeParameters

    file = tmp_path / "params.yaml"
    file.write_text(
        "/**: {ros__parameters: {scenario: paper_20, gains: {hold: {gain_1_s: 0.75}},"
        " communication: {tree: {2: 1, 20: 2}}}}\n"
        "/uav1/controller: {ros__parameters: {gains.hold.gain_1_s: 0.5}}\n"
        "/uav10/controller: {ros__parameters: {gains.hold.gain_1_s: 0.25}}\n",
        encoding="utf-8",
    )
    node = ros.node(
        "controller",
        namespace=f"/uav{uav}",
        automatically_declare_parameters_from_overrides=True,
        cli_args=["--ros-args", "--params-file", str(file)],
    )
    told = NodeParameters(node, (*SCENARIO, UAV))
    told.declare_scenario()
    assert (told.uav, told.scenario.file.gains.hold.gain_1_s) == (uav, gain)
    assert (told.scenario.parent(2), told.scenario.parent(20)) == (1, 2)
