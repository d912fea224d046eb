"""Each process of a fleet may use the edges of its scenario, and nothing else."""

import contextlib
from fnmatch import fnmatchcase

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.security.permissions import permissions
from ptnsbc_sim.scenario import load_scenario

_NODES = {"controller": "uav", "sim": "sim", "recorder": "recorder", "fleet": "fleet"}
_LOOK_S = 20.0


def granted(scenario, backend="sim", namespace=""):
    edges = CommunicationGraph(scenario, FlightOptions(bridged=backend == "mavlink"))
    return {one.enclave: one for one in permissions(scenario, edges, backend, namespace)}


def may(names, topic):
    return any(fnmatchcase(topic, name) for name in names)


def used(looker, name, namespace):
    """The DDS topics that a node publishes and reads, as the graph of ROS shows them."""
    publishes, reads = set(), set()
    for topic, _ in looker.get_publisher_names_and_types_by_node(name, namespace):
        publishes.add(f"rt{topic}")
    for topic, _ in looker.get_subscriber_names_and_types_by_node(name, namespace):
        reads.add(f"rt{topic}")
    for service, _ in looker.get_service_names_and_types_by_node(name, namespace):
        publishes.add(f"rr{service}Reply")
        reads.add(f"rq{service}Request")
    for service, _ in looker.get_client_names_and_types_by_node(name, namespace):
        publishes.add(f"rq{service}Request")
        reads.add(f"rr{service}Reply")
    return publishes, reads


def enclave(name, namespace):
    return namespace if name == "controller" else f"/{name}"


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [{}, {"formation.assignment": "optimal", "formation.task": "relative_position"}],
    ids=["fixed", "open slots"],
)
def test_what_the_processes_of_a_fleet_use_is_granted(ros, launch, tmp_path, changes):
    scenario = load_scenario("paper_5", changes)
    (tmp_path / "flown.yaml").write_text(scenario.text)
    flight = launch(
        *("--scenario", str(tmp_path / "flown.yaml"), "--duration", "60"),
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
    refused = {
        name: sorted(
            {topic for topic in publishes if not may(allowed[name].publish, topic)}
            | {topic for topic in reads if not may(allowed[name].subscribe, topic)}
        )
        for name, (publishes, reads) in seen.items()
    }
    assert not {name: topics for name, topics in refused.items() if topics}
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
                assert not may(own.publish, f"rt/uav{other}/{topic}")
            assert may(own.subscribe, f"rt/uav{other}/formation_state") == (
                other in senders.heard_states
            )
            assert may(own.subscribe, f"rt/uav{other}/leader_estimate") == (
                other in senders.heard_estimators
            )
            assert not may(own.publish, f"rr/uav{other}/controller/get_parametersReply")
        assert may(own.publish, "rt/formation/epoch") == (uav == scenario.leader_id)
        assert not may(own.publish, "rt/formation/emergency")
        assert not may(own.publish, f"rt/uav{uav}/odom")


def test_a_bridge_speaks_for_its_vehicle_alone():
    allowed = granted(load_scenario("experiment_4"), "mavlink")
    assert "/sim" not in allowed
    bridge = allowed["/bridge2"]
    assert may(bridge.publish, "rt/uav2/odom")
    assert may(bridge.publish, "rt/formation/emergency")
    assert not may(bridge.publish, "rt/uav3/odom")
    assert not may(bridge.publish, "rt/uav2/setpoint/velocity")
    assert may(bridge.subscribe, "rt/uav3/track")


def test_the_names_of_a_fleet_in_a_namespace_are_its_own():
    allowed = granted(load_scenario("paper_5"), namespace="/blue")
    assert "/blue/uav2" in allowed
    own = allowed["/blue/uav2"]
    assert may(own.publish, "rt/blue/uav2/formation_state")
    assert not may(own.publish, "rt/uav2/formation_state")
    assert not may(own.publish, "rt/red/uav2/formation_state")
