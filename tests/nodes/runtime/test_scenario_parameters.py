"""The single values of a scenario, and what the types of the file say of them."""

import math

import pytest

from ptnsbc_nodes.runtime.scenario_parameters import leaves
from ptnsbc_sim.scenario import load_scenario


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
    assert "world.wind_m_s" not in found


@pytest.mark.parametrize("name", ["paper_5", "paper_20", "experiment_4"])
def test_each_key_is_one_that_overrides(name):
    scenario = load_scenario(name)
    values = {leaf.key: leaf.value for leaf in leaves(scenario)}
    assert load_scenario(name, values).file == scenario.file
