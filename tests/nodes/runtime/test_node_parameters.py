"""ROS parameters of a node: declared, described, kept in range, and fixed once configured."""

import pytest

pytest.importorskip("rclpy")

from rclpy.parameter import Parameter

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.node_parameters import (
    AUTOSTART,
    BRIDGED,
    SCENARIO,
    UAV,
    NodeParameters,
    ScenarioParameterError,
    overrides,
)
from ptnsbc_sim.scenario import load_scenario

pytestmark = pytest.mark.ros

FIXED = (*SCENARIO, UAV, BRIDGED, AUTOSTART)
KAPPA = "gains.formation.kappa_1_s"


@pytest.fixture
def told(ros):
    """A node with parameters, from what the command line and ROS give it."""

    def make(given=None, *, ros_args=(), namespace="/uav3", fixed=""):
        given = {"scenario": "paper_5"} if given is None else given
        node = ros.node(
            "controller",
            namespace=namespace,
            parameter_overrides=overrides(given),
            automatically_declare_parameters_from_overrides=True,
            cli_args=["--ros-args", *ros_args],
        )
        parameters = NodeParameters(node, FIXED, fixed=lambda: fixed)
        return node, parameters

    return make


def test_what_is_fixed_is_read_only_and_described(told):
    node, parameters = told()
    for one in FIXED:
        about = node.describe_parameter(one.key)
        assert about.read_only
        assert about.description == one.description
    assert (parameters.uav, parameters["autostart"]) == (3, True)
    (result,) = node.set_parameters([Parameter("lockstep", value=True)])
    assert not result.successful


def test_nobody_names_a_file_to_execute_over_ros(told, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("def law(inputs):\n    return (0.0, 0.0, 0.0)\n")
    (tmp_path / "flown.yaml").write_text("extends: paper_5_free\nlaw: mine.py:law\n")
    node, parameters = told({"scenario": str(tmp_path / "flown.yaml")})
    (result,) = node.set_parameters([Parameter("law", value="/tmp/other.py:law")])
    assert not result.successful and "give it in the scenario file" in result.reason
    assert parameters.scenario.law == f"{file}:law"


def test_values_of_the_scenario_have_description_and_range(told):
    node, parameters = told()
    about = node.describe_parameter(KAPPA)
    assert about.description and not about.read_only
    assert about.floating_point_range[0].from_value == 0.0
    assert node.get_parameter(KAPPA).value == parameters.scenario.gains.formation.kappa_1_s
    assert node.describe_parameter("mavlink.rate_hz").integer_range[0].to_value == 100
    assert "set_based" in node.describe_parameter("formation.avoidance").additional_constraints


def test_a_value_may_be_changed_until_the_node_is_configured(told):
    node, parameters = told()
    (result,) = node.set_parameters([Parameter(KAPPA, value=3.5)])
    assert result.successful
    assert parameters.scenario.gains.formation.kappa_1_s == 3.5
    node, parameters = told(fixed="clean it up first")
    (result,) = node.set_parameters([Parameter(KAPPA, value=3.5)])
    assert not result.successful
    assert "clean it up first" in result.reason
    assert parameters.scenario.gains.formation.kappa_1_s != 3.5


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        (KAPPA, -1.0, "range"),
        ("gains.formation.residual", 0.0, "gains.formation.residual"),
        ("formation.avoidance", "always", "set_based"),
        ("timing.control_hz", 3000, "range"),
    ],
)
def test_a_value_that_the_scenario_cannot_have_is_refused(told, name, value, reason):
    node, parameters = told()
    before = parameters.scenario
    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert reason in result.reason
    assert parameters.scenario is before


def test_parameters_from_ros_arrive_and_the_command_line_wins(told):
    _, parameters = told(
        {"scenario": "paper_5", "lockstep": True},
        ros_args=["-p", f"{KAPPA}:=4", "-p", "scenario:=paper_20", "-p", "uav:=2"],
        namespace="/",
    )
    assert parameters.scenario.name == "paper_5"
    assert parameters.scenario.gains.formation.kappa_1_s == 4.0  # written as an integer
    assert (parameters.uav, parameters.options.lockstep) == (2, True)


def test_a_list_and_what_is_below_an_id_can_be_given_too(told):
    node, parameters = told(
        {"scenario": "paper_5", "communication.tree.5": 3},
        ros_args=["-p", "world.wind_m_s:=[1.0,0.0,0.0]"],
    )
    assert parameters.scenario.world.wind_m_s == (1.0, 0.0, 0.0)
    assert parameters.scenario.communication.parent(5) == 3
    assert node.describe_parameter("communication.tree.5").read_only


def test_a_list_of_numbers_is_a_parameter_with_its_unit(told):
    node, parameters = told()
    assert list(node.get_parameter("plant.inertia_kg_m2").value) == [0.019, 0.019, 0.021]
    assert list(node.get_parameter("communication.leader_links").value) == [2, 3, 4, 5]
    assert node.describe_parameter("world.wind_m_s").description
    (result,) = node.set_parameters([Parameter("world.wind_m_s", value=[0.0, 2.0, 0.0])])
    assert result.successful, result.reason
    assert parameters.scenario.world.wind_m_s == (0.0, 2.0, 0.0)
    (result,) = node.set_parameters([Parameter("world.wind_m_s", value=[0.0, 2.0])])
    assert not result.successful


def test_the_time_of_a_node_is_fixed_with_its_scenario(told):
    node, _ = told(fixed="the flight has begun")
    (result,) = node.set_parameters([Parameter("use_sim_time", value=True)])
    assert not result.successful
    assert "the flight has begun" in result.reason
    assert node.get_parameter("use_sim_time").value is False
    node, _ = told()
    (result,) = node.set_parameters([Parameter("use_sim_time", value=True)])
    assert result.successful


def test_a_parameter_that_no_node_has_is_refused_with_the_nearest(told):
    with pytest.raises(
        ScenarioParameterError, match=r"autostrat: this node has none: perhaps auto"
    ):
        told(ros_args=["-p", "autostrat:=false"])


def test_a_scenario_may_come_as_text(told):
    text = load_scenario("paper_20").text
    _, parameters = told({"scenario_text": text, "uav": 20})
    assert len(parameters.scenario.uav_ids) == 20


@pytest.mark.parametrize(
    ("given", "ros_args", "says"),
    [
        ({}, (), "neither is given"),
        ({"scenario": "paper_5", "scenario_text": "name: x"}, (), "not both"),
        ({"scenario": "paper_5", "uav": 9}, (), "UAV 9: expected one of 1, 2"),
        ({"scenario": "paper_5", "uav": 999}, (), "parameter uav: 999: expected 0 to 254"),
        ({"scenario": "paper_5"}, ("-p", "lockstep:=soon"), "lockstep: 'soon': expected bool"),
        ({"scenario": "paper_5"}, ("-p", "gains.formatoin.scale:=1.0"), "formatoin"),
        ({"scenario": "paper_5"}, ("-p", f"{KAPPA}:=-2.0"), KAPPA),
    ],
)
def test_what_a_node_cannot_start_with_is_said(told, given, ros_args, says):
    with pytest.raises(PtnsbcError, match=says):
        told(given, ros_args=ros_args)


def test_without_id_and_namespace_there_is_no_uav(told):
    with pytest.raises(ScenarioParameterError, match="expected --uav N, or a namespace /uavN"):
        told(namespace="/somewhere")
