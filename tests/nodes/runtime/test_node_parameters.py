"""ROS parameters of a node: they set no value of a flight, and tell its scenario."""

import argparse

import pytest

pytest.importorskip("rclpy")

from rclpy.parameter import Parameter

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.node_parameters import NodeParameterError, fix_parameters
from ptnsbc_nodes.runtime.node_process import Arguments, flown
from ptnsbc_sim.scenario import load_scenario, scenario_from_text

pytestmark = pytest.mark.ros

SCENARIO = load_scenario("paper_5", {"seed": 9})


@pytest.fixture
def told(ros):
    """A node that was given these words after --ros-args."""

    def make(*ros_args):
        node = ros.node(
            "controller",
            namespace="/uav3",
            automatically_declare_parameters_from_overrides=True,
            cli_args=["--ros-args", *ros_args],
        )
        fix_parameters(node, SCENARIO)
        return node

    return make


def test_a_node_tells_its_scenario_and_lets_nobody_change_it(told):
    node = told()
    assert scenario_from_text(node.get_parameter("scenario").value) == SCENARIO
    (result,) = node.set_parameters([Parameter("scenario", value="name: other")])
    assert not result.successful


@pytest.mark.parametrize("name", ["gains.formation.kappa_1_s", "scenario", "uav", "autostart"])
def test_a_value_of_the_flight_from_ros_is_refused_with_what_to_do(told, name):
    with pytest.raises(NodeParameterError, match=f"parameter {name}: .*--set {name}=VALUE"):
        told("-p", f"{name}:=4")


def test_a_parameter_file_with_values_of_the_flight_is_refused(told, tmp_path):
    file = tmp_path / "fleet.params.yaml"
    file.write_text("/**: {ros__parameters: {gains: {hold: {gain_1_s: 0.5}}}}")
    with pytest.raises(NodeParameterError, match=r"parameter gains\.hold\.gain_1_s"):
        told("--params-file", str(file))


def test_the_time_of_a_node_is_given_at_its_start_alone(told):
    node = told("-p", "use_sim_time:=true", "-p", "qos_overrides./clock.subscription.depth:=2")
    assert node.get_parameter("use_sim_time").value is True
    (result,) = node.set_parameters([Parameter("use_sim_time", value=False)])
    assert not result.successful and "fixed since" in result.reason
    assert node.get_parameter("use_sim_time").value is True


def parsed(*words: str) -> argparse.Namespace:
    return Arguments("uav", "").parse_args(["--scenario", "paper_5", *words])


def test_a_process_flies_the_file_with_the_values_that_it_is_given():
    given = parsed("--set", "seed=9", "--set", "world.wind_m_s=[1, 0, 0]")
    assert flown(given, {"timing.duration_s": None}) == load_scenario(
        "paper_5", {"seed": 9, "world.wind_m_s": [1, 0, 0]}
    )
    assert flown(parsed("--bridged")) == load_scenario("paper_5").bridged()


@pytest.mark.parametrize(
    ("words", "says"),
    [("seed", "seed"), ("=4", "expected KEY=VALUE"), ("gains.formatoin.scale=4", "formatoin")],
)
def test_what_is_no_value_of_the_scenario_is_refused(words, says):
    with pytest.raises(PtnsbcError, match=says):
        flown(parsed("--set", words))
