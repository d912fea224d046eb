"""Permissions of each process of a fleet with DDS Security: the topics of its edges in the scenario, and no more.

Names are those of DDS. ROS puts `rt` before a topic, `rq` and `rr` before the two topics of a service. A `*` stands
for any characters, slashes included.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Literal

from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.topics import Topic
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.slots import are_open

FLEET, OPERATOR = "fleet", "operator"
"""Enclaves of the launcher, and of what an operator runs beside it: `ptnsbc stop`, `view`, `inject`, ros2, RViz."""

_OPERATORS_NODES = ("/operator*", "/stop_*", "/mission_*", "/inject_*", "/view*", "/_ros2cli*")
_GRAPH = "ros_discovery_info"  # with it the processes tell each other their nodes


@dataclass
class Permission:
    """The DDS topics of one process."""

    enclave: str  # path of its identity in the keystore, "/blue/uav1"
    publish: list[str] = field(default_factory=list)
    subscribe: list[str] = field(default_factory=list)


class _Permitted:
    """Collects the permission of one process of a fleet."""

    def __init__(self, namespace: str, name: str) -> None:
        self._namespace = namespace
        self.permission = Permission(f"{namespace}/{name}", [_GRAPH], [_GRAPH])
        self.publishes(topics.DIAGNOSTICS, topics.READY)
        self.permission.publish += ["rt/rosout", "rt/parameter_events"]
        self.permission.subscribe += ["rt/parameter_events"]
        self.reads(topics.LOST, topics.CLOCK)

    def publishes(self, *which: Topic) -> None:
        self.permission.publish += map(self._topic, which)

    def reads(self, *which: Topic) -> None:
        self.permission.subscribe += map(self._topic, which)

    def serves(self, *names: str) -> None:
        """Services below the namespace; `*` at the end for all of a node."""
        self.permission.publish += [f"rr{self._namespace}{name}Reply" for name in names]
        self.permission.subscribe += [f"rq{self._namespace}{name}Request" for name in names]

    def calls(self, *names: str) -> None:
        """The other side of `serves`."""
        self.permission.publish += [f"rq{self._namespace}{name}Request" for name in names]
        self.permission.subscribe += [f"rr{self._namespace}{name}Reply" for name in names]

    def is_node(self, name: str) -> None:
        """Its parameters and its life cycle."""
        self.serves(f"{name}/*")
        self.permission.publish.append(f"rt{self._namespace}{name}/transition_event")

    def _topic(self, topic: Topic) -> str:
        above = "" if topic is topics.TF else self._namespace
        return f"rt{above}{topic.name}"


def permissions(
    scenario: Scenario,
    edges: CommunicationGraph,
    backend: Literal["sim", "mavlink"],
    namespace: str = "",
) -> Iterator[Permission]:
    """The permissions of each process of a fleet.

    Args:
        scenario: Its edges say who hears whom.
        edges: Of that scenario.
        backend: What flies the vehicles.
        namespace: Of the fleet, "/blue", or empty.
    """
    ids = scenario.uav_ids
    for uav in ids:
        yield _uav(scenario, edges, uav, namespace)
        if backend == "mavlink":
            yield _bridge(scenario, edges, uav, namespace)
    if backend == "sim":
        yield _sim(ids, namespace)
    yield _recorder(scenario, namespace)
    yield _launcher(scenario, namespace)
    yield _operator(namespace)


def _uav(scenario: Scenario, edges: CommunicationGraph, uav: int, namespace: str) -> Permission:
    own, senders = _Permitted(namespace, f"uav{uav}"), edges.senders(uav)
    own.is_node(f"/uav{uav}/controller")
    own.publishes(
        *(topics.formation_state(uav), topics.leader_estimate(uav)),
        *(topics.velocity_setpoint(uav), topics.wrench_setpoint(uav)),
        *(*topics.notes(uav), topics.robot_description(uav)),
    )
    own.reads(
        *(topics.odom(uav), topics.near(uav), topics.limits(uav)),
        *(topics.EPOCH, topics.SLOTS, topics.FAULT),
        *map(topics.formation_state, senders.heard_states),
        *map(topics.leader_estimate, senders.heard_estimators),
    )
    leads = uav == scenario.leader_id or uav in scenario.file.leader.successors
    if leads:
        own.publishes(topics.EPOCH, topics.TAKEN)
        own.reads(topics.REQUEST, topics.SETPOINT)
        own.serves("/formation/*")
    if leads and are_open(scenario):
        own.publishes(topics.SLOTS)
        own.reads(*map(topics.odom, scenario.uav_ids))
    return own.permission


def _bridge(scenario: Scenario, edges: CommunicationGraph, uav: int, namespace: str) -> Permission:
    own = _Permitted(namespace, f"bridge{uav}")
    own.is_node(f"/uav{uav}/bridge")
    own.publishes(
        *(topics.odom(uav), topics.near(uav), topics.truth(uav), topics.track(uav)),
        *(topics.limits(uav), topics.battery(uav), topics.TF),
        *(topics.EMERGENCY, topics.LOST),
    )
    if uav == scenario.leader_id:
        own.publishes(topics.ORIGIN)
    own.reads(
        *(topics.velocity_setpoint(uav), topics.wrench_setpoint(uav)),
        *(topics.EPOCH, topics.TAKEN, topics.EMERGENCY, topics.ORIGIN, topics.DIAGNOSTICS),
    )
    others = [other for other in scenario.uav_ids if other != uav]
    own.reads(*map(topics.odom, others), *map(topics.track, others))
    return own.permission


def _sim(uavs: Iterable[int], namespace: str) -> Permission:
    own, ids = _Permitted(namespace, topics.SIM), tuple(uavs)
    own.is_node("/sim")
    own.publishes(topics.CLOCK, topics.TF, topics.MARKERS)
    for uav in ids:
        own.publishes(topics.odom(uav), topics.near(uav), topics.truth(uav))
    own.reads(topics.EPOCH, topics.RECORDED, *map(topics.wrench_setpoint, ids))
    return own.permission


def _recorder(scenario: Scenario, namespace: str) -> Permission:
    own = _Permitted(namespace, topics.RECORDER)
    own.is_node("/recorder")
    own.publishes(topics.RECORDED)
    every = topics.recorded(
        scenario.uav_ids, lockstep=False, with_truth=True, with_slots=True, with_stream=True
    )
    own.reads(*every)
    return own.permission


def _launcher(scenario: Scenario, namespace: str) -> Permission:
    own = _Permitted(namespace, FLEET)
    own.is_node("/fleet*")  # launchers on several computers have names of their own
    own.publishes(topics.REQUEST, topics.LOST, topics.EMERGENCY, topics.OVER, topics.FAULT)
    own.reads(topics.DIAGNOSTICS, topics.READY, topics.OVER, topics.FAULT)
    own.reads(topics.EPOCH, topics.REQUEST)
    own.serves("/formation/arm")
    own.reads(*map(topics.odom, scenario.uav_ids))
    own.calls("/formation/*", "/uav*")
    return own.permission


def _operator(namespace: str) -> Permission:
    """Reads everything; publishes what an operator orders; offers the fleet in the types of ptnsbc_interfaces."""
    own = _Permitted(namespace, OPERATOR)
    for node in _OPERATORS_NODES:
        own.is_node(node)
    own.publishes(topics.REQUEST, topics.LOST, topics.EMERGENCY, topics.FAULT, topics.SETPOINT)
    own.calls("/*")
    own.serves("/formation/*")
    offered = f"rt{namespace}/formation/"
    own.permission.publish += [f"{offered}state", f"{offered}announced", f"{offered}*/_action/*"]
    own.permission.subscribe += [f"rt{namespace}/*", "rt/tf", "rt/rosout"]
    return own.permission
