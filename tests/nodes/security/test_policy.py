"""Each process of a fleet may use the edges of its scenario, and nothing else."""

import contextlib
import re
from fnmatch import fnmatchcase
from xml.etree import ElementTree

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.security.policy import enclaves, policy
from ptnsbc_sim.scenario import load_scenario

_NODES = {"controller": "uav", "sim": "sim", "recorder": "recorder", "fleet": "fleet"}
_LOOK_S = 20.0


_RULES = {"publish": "topic", "subscribe": "topic", "reply": "service", "request": "service"}


def made(scenario, backend="sim", namespace=""):
    edges = CommunicationGraph(scenario, FlightOptions(bridged=backend == "mavlink"))
    return policy(enclaves(scenario, edges, backend), namespace)


def granted(scenario, backend="sim", namespace=""):
    """What each enclave may use, by rule, as sros2 reads it."""
    return {
        enclave.get("path"): {
            rule: {name.text for name in enclave.iterfind(f"*/*/{kind}s[@{rule}='ALLOW']/{kind}")}
            for rule, kind in _RULES.items()
        }
        for enclave in ElementTree.fromstring(made(scenario, backend, namespace)).iter("enclave")
    }


def may(names, topic):
    return any(fnmatchcase(topic, name) for name in names)


def used(looker, name, namespace):
    """The topics and services that a node uses, by rule, as the graph of ROS shows them."""
    ask = {
        "publish": looker.get_publisher_names_and_types_by_node,
        "subscribe": looker.get_subscriber_names_and_types_by_node,
        "reply": looker.get_service_names_and_types_by_node,
        "request": looker.get_client_names_and_types_by_node,
    }
    return {rule: {found for found, _ in names(name, namespace)} for rule, names in ask.items()}


def enclave(name, namespace):
    return namespace if name == "controller" else f"/{name}"


@pytest.mark.parametrize(
    ("scenario", "backend", "namespace"),
    [("paper_5", "sim", ""), ("experiment_4", "mavlink", "/blue"), ("relay", "sim", "")],
)
def test_the_policy_has_the_form_that_sros2_demands(scenario, backend, namespace):
    """sros2/policy/schemas/policy.xsd, version 0.2.0, and what `ros2 security` looks for in it."""
    root = ElementTree.fromstring(made(load_scenario(scenario), backend, namespace))
    assert (root.tag, root.attrib) == ("policy", {"version": "0.2.0"})
    (parts,) = root
    assert parts.tag == "enclaves"
    paths = [one.get("path") for one in parts]
    assert len(paths) == len(set(paths)) > 0
    for one in parts:
        assert (one.tag, one.attrib.keys()) == ("enclave", {"path"})
        assert re.fullmatch(rf"{namespace}/[a-z_0-9]+", one.get("path"))
        (profiles,) = one
        (profile,) = profiles
        assert (profiles.tag, profile.tag) == ("profiles", "profile")
        assert profile.attrib.keys() == {"ns", "node"}
        assert profile.get("ns").startswith("/")
        assert len(profile)
        for rules in profile:
            ((rule, verdict),) = rules.attrib.items()
            assert (rules.tag, verdict) == (f"{_RULES[rule]}s", "ALLOW")
            assert len(rules)
            for name in rules:
                assert (name.tag, name.attrib) == (_RULES[rule], {})
                assert name.text.startswith("/")  # else sros2 puts it below the node's namespace


@pytest.mark.slow
def test_what_the_processes_of_a_fleet_use_is_granted(ros, launch, tmp_path):
    """With open slots, by which they use all topics of a fleet with fixed ones, and more."""
    open_slots = {"formation.assignment": "optimal", "formation.task": "relative_position"}
    scenario = load_scenario("paper_5", open_slots)
    (tmp_path / "flown.yaml").write_text(scenario.text)
    flight = launch(
        *("--scenario", str(tmp_path / "flown.yaml"), "--duration", "60", "--processes", "2"),
        *("--bag", str(tmp_path / "bag")),
        domain=ros.domain,
    )
    looker = ros.node("looker")
    flight.wait_for("started")
    allowed = granted(scenario)
    seen = {}

    def all_seen():
        for name, namespace in looker.get_node_names_and_namespaces():
            if name in _NODES:
                seen[enclave(name, namespace)] = used(looker, name, namespace)
        return seen.keys() == allowed.keys() - {"/operator"}

    with contextlib.suppress(TimeoutError):
        ros.spin_until(all_seen, timeout=_LOOK_S)
    ros.spin_for(1.0)  # what is discovered a little later counts as well
    assert all_seen(), seen.keys()
    refused = [
        (name, rule, topic)
        for name, rules in seen.items()
        for rule, names in rules.items()
        for topic in sorted(names)
        if not may(allowed[name][rule], topic)
    ]
    assert refused == []
    flight.process.terminate()
    flight.finish()


def test_a_uav_reads_its_edges_and_speaks_for_nobody_else():
    scenario = load_scenario("paper_5")
    allowed = granted(scenario)
    edges = CommunicationGraph(scenario, FlightOptions())
    for uav in scenario.uav_ids:
        own = allowed[f"/uav{uav}"]
        senders = edges.senders(uav)
        for other in scenario.uav_ids:
            if other == uav:
                continue
            for topic in ("formation_state", "leader_estimate", "setpoint/wrench", "odom"):
                assert not may(own["publish"], f"/uav{other}/{topic}")
            assert may(own["subscribe"], f"/uav{other}/formation_state") == (
                other in senders.heard_states
            )
            assert may(own["subscribe"], f"/uav{other}/leader_estimate") == (
                other in senders.heard_estimators
            )
            assert not may(own["reply"], f"/uav{other}/controller/get_parameters")
        assert may(own["publish"], "/formation/epoch") == (uav == scenario.leader.id)
        assert not may(own["publish"], "/formation/emergency")
        assert not may(own["publish"], f"/uav{uav}/odom")


def test_a_bridge_speaks_for_its_vehicle_alone():
    allowed = granted(load_scenario("experiment_4"), "mavlink")
    assert "/sim" not in allowed
    bridge = allowed["/bridge2"]
    assert may(bridge["publish"], "/uav2/odom")
    assert may(bridge["publish"], "/formation/emergency")
    assert not may(bridge["publish"], "/uav3/odom")
    assert not may(bridge["publish"], "/uav2/setpoint/velocity")
    assert may(bridge["subscribe"], "/uav3/track")


def test_the_names_of_a_fleet_in_a_namespace_are_its_own():
    allowed = granted(load_scenario("paper_5"), namespace="/blue")
    assert "/blue/uav2" in allowed
    own = allowed["/blue/uav2"]
    assert may(own["publish"], "/blue/uav2/formation_state")
    assert not may(own["publish"], "/uav2/formation_state")
    assert not may(own["publish"], "/red/uav2/formation_state")
