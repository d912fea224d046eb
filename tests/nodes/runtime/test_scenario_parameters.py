"""The single values of a scenario as parameters, and the parameter file that brings a node all of them."""

import math

import pytest
import yaml

from ptnsbc_nodes.runtime.scenario_parameters import given_parameters, leaves, parameter_file
from ptnsbc_sim.scenario import ScenarioError, load_scenario, scenario_from_text


@pytest.fixture(scope="module")
def found():
    return {leaf.key: leaf for leaf in leaves(load_scenario("experiment_4"))}


def test_a_gain_has_its_value_and_its_limits(found):
    leaf = found["gains.formation.residual"]
    assert leaf.value == load_scenario("experiment_4").gains.formation.residual
    assert (leaf.low, leaf.high) == (0.0, 1.0)
    assert leaf.rule == "more than 0; less than 1"
    assert leaf.description


def test_limits_inside_an_optional_value_count(found):
    assert found["mavlink.rate_hz"].low == 20
    assert found["mavlink.rate_hz"].high == 100
    assert found["sensor.positioning.latency_s"].high == 1


def test_choices_are_named(found):
    assert found["formation.avoidance"].rule == "one of: off, set_based, switched"
    assert found["formation.avoidance"].low == -math.inf


def test_what_has_no_name_of_its_own_is_left_out(found):
    assert not any(key.startswith(("uavs", "communication.tree", "world.obst")) for key in found)


def test_a_list_of_numbers_is_one_value(found):
    assert found["world.wind_m_s"].value == [1.6, 1.2, 0.0]
    assert found["communication.leader_links"].value == [2, 3, 4]


@pytest.mark.parametrize("name", ["paper_5", "paper_20", "experiment_4"])
def test_each_key_is_one_that_overrides(name):
    scenario = load_scenario(name)
    values = {leaf.key: leaf.value for leaf in leaves(scenario)}
    assert load_scenario(name, values) == scenario


def test_no_value_is_in_it_twice():
    tree = yaml.safe_load(parameter_file(load_scenario("paper_5")))["/**"]["ros__parameters"]
    text = yaml.safe_load(tree["scenario_text"])
    assert tree["gains"]["formation"]["kappa_1_s"] == 2.2
    assert "gains" not in text
    assert text["formation"].keys() == {"offsets_m"}
    assert len(text["uavs"]) == 5


@pytest.mark.ros
@pytest.mark.parametrize("name", ["paper_5", "experiment_4", "mission_6", "corridor"])
def test_a_node_reads_the_same_scenario_from_it(ros, tmp_path, name):
    from ptnsbc_nodes.runtime.node_parameters import SCENARIO, UAV, NodeParameters

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
    changed = load_scenario(name, {"gains.hold.gain_1_s": 0.75})
    assert (told.uav, told.scenario) == (2, changed)


@pytest.mark.ros
@pytest.mark.parametrize(("uav", "gain"), [(1, 0.5), (10, 0.25), (2, 0.75)])
def test_uav1_and_uav10_have_their_own(ros, tmp_path, uav, gain):
    """A name with a digit more is another name, and so is a key with a number in it."""
    from ptnsbc_nodes.runtime.node_parameters import SCENARIO, UAV, NodeParameters

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
    assert (told.uav, told.scenario.gains.hold.gain_1_s) == (uav, gain)
    assert (told.scenario.communication.parent(2), told.scenario.communication.parent(20)) == (1, 2)


def test_a_parameter_file_is_read_back_as_the_same_scenario():
    scenario = load_scenario("experiment_4", {"gains.formation.kappa_1_s": 2.25})
    given = given_parameters(parameter_file(scenario), "fleet.yaml")
    again = scenario_from_text(given.text, given.values, source="fleet.yaml")
    assert again == scenario


def test_the_dump_of_one_node_gives_the_values_of_the_scenario_alone():
    dumped = {"uav": 3, "use_sim_time": False, "qos_overrides": {"/clock": {"depth": 1}}, "seed": 7}
    text = yaml.safe_dump({"/uav3/controller": {"ros__parameters": dumped}})
    assert given_parameters(text, "dump.yaml") == ({"seed": 7}, "")


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ({"/**": {"ros__parameters": {"gain": 1}}}, "fleet.yaml: /\\*\\*: gain: no parameter"),
        ({"/**": {"seed": 1}}, "expected ros__parameters"),
        ({"/**": 3}, "expected ros__parameters"),
        (
            {"/a": {"ros__parameters": {"seed": 1}}, "/b": {"ros__parameters": {"seed": 2}}},
            "/b: seed: 2, but another node has 1",
        ),
    ],
)
def test_what_is_no_parameter_file_of_a_fleet_is_refused(file, words):
    with pytest.raises(ScenarioError, match=words):
        given_parameters(yaml.safe_dump(file), "fleet.yaml")
