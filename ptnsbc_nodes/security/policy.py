"""The policy of a fleet for sros2: the topics and services of each process, by the edges of the scenario, and no more.

`ros2 security generate_artifacts -k KEYSTORE -p POLICY` makes a keystore of it. The form is version 0.2.0 of sros2's
`policy.xsd`: an enclave for each process, with the profile of its node. A `*` in a name stands for any characters,
slashes included.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Literal
from xml.etree import ElementTree

from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.topics import Topic
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.slots import are_open

VERSION = "0.2.0"
FLEET, OPERATOR = "fleet", "operator"
"""Enclaves of the launcher, and of what an operator runs beside it: `ptnsbc stop`, `view`, `inject`, ros2, RViz."""

_OPERATORS_NODES = ("operator*", "stop_*", "mission_*", "inject_*", "view*", "_ros2cli*")


@dataclass
class Enclave:
    """One process of a fleet, and what it may use, by names of ROS.

    Attributes:
        fleet: namespace of the fleet, "/blue", or empty.
        name: of the process.
        nodes: its nodes below the fleet.
    """

    fleet: str
    name: str
    nodes: tuple[str, ...]
    publish: list[str] = field(default_factory=list)
    subscribe: list[str] = field(default_factory=list)
    reply: list[str] = field(default_factory=list)  # services that it offers
    request: list[str] = field(default_factory=list)  # services that it calls

    def __post_init__(self) -> None:
        """Every node has parameters, a life cycle, a log and a status."""
        self.publish += ["/rosout", "/parameter_events"]
        self.subscribe += ["/parameter_events"]
        self.publish += [f"{self.fleet}/{node}/transition_event" for node in self.nodes]
        self.reply += [f"{self.fleet}/{node}/*" for node in self.nodes]
        self.allow("publish", topics.DIAGNOSTICS, topics.READY)
        self.allow("subscribe", topics.LOST, topics.CLOCK)

    @property
    def path(self) -> str:
        """Of its artifacts in the keystore, "/blue/uav1"; a process is started with `--enclave` and this."""
        return f"{self.fleet}/{self.name}"

    def allow(self, rule: Literal["publish", "subscribe"], *allowed: Topic) -> None:
        """Add topics to a rule; only /tf is common to all fleets."""
        names: list[str] = getattr(self, rule)
        names += [one.name if one is topics.TF else self.fleet + one.name for one in allowed]


def enclaves(
    scenario: Scenario,
    edges: CommunicationGraph,
    backend: Literal["sim", "mavlink"],
    fleet: str = "",
) -> Iterator[Enclave]:
    """Each process of a fleet, with what it may use.

    Args:
        scenario: Its edges say who hears whom.
        edges: Of that scenario.
        backend: What flies the vehicles.
        fleet: Namespace of the fleet, "/blue", or empty.
    """
    for uav in scenario.uav_ids:
        yield _uav(scenario, edges, uav, fleet)
        if backend == "mavlink":
            yield _bridge(scenario, uav, fleet)
    odometry = [topics.odom(uav) for uav in scenario.uav_ids]
    if backend == "sim":
        sim = Enclave(fleet, topics.SIM, ("sim",))
        sim.allow("publish", topics.CLOCK, topics.TF, topics.MARKERS, *odometry)
        for uav in scenario.uav_ids:
            sim.allow("publish", topics.near(uav), topics.truth(uav))
            sim.allow("subscribe", topics.wrench_setpoint(uav))
        sim.allow("subscribe", topics.EPOCH, topics.RECORDED)
        yield sim
    recorder = Enclave(fleet, topics.RECORDER, ("recorder",))
    recorder.allow("publish", topics.RECORDED)
    every = topics.recorded(
        scenario.uav_ids, lockstep=False, with_truth=True, with_slots=True, with_stream=True
    )
    recorder.allow("subscribe", *every)
    yield recorder
    launcher = Enclave(fleet, FLEET, ("fleet*",))  # launchers on several computers differ in name
    orders = topics.REQUEST, topics.LOST, topics.EMERGENCY, topics.FAULT
    launcher.allow("publish", topics.OVER, *orders)
    heard = topics.DIAGNOSTICS, topics.READY, topics.OVER, topics.FAULT, topics.EPOCH
    launcher.allow("subscribe", topics.REQUEST, *heard, *odometry)
    launcher.reply.append(f"{fleet}/formation/arm")
    launcher.request += [f"{fleet}/formation/*", f"{fleet}/uav*"]
    yield launcher
    # Reads everything, publishes what is ordered, and offers the fleet in the types of ptnsbc_interfaces.
    operator = Enclave(fleet, OPERATOR, _OPERATORS_NODES)
    operator.allow("publish", topics.SETPOINT, *orders)
    offered = ("state", "announced", "*/_action/*")
    operator.publish += [f"{fleet}/formation/{name}" for name in offered]
    operator.subscribe += [f"{fleet}/*", "/tf", "/rosout"]
    operator.reply.append(f"{fleet}/formation/*")
    operator.request.append(f"{fleet}/*")
    yield operator


def _uav(scenario: Scenario, edges: CommunicationGraph, uav: int, fleet: str) -> Enclave:
    process = Enclave(fleet, f"uav{uav}", (f"uav{uav}/controller",))
    process.allow(
        "publish",
        *(topics.formation_state(uav), topics.leader_estimate(uav)),
        *(topics.velocity_setpoint(uav), topics.wrench_setpoint(uav)),
        *(*topics.notes(uav), topics.robot_description(uav)),
    )
    process.allow(
        "subscribe",
        *(*edges.heard_by(uav), topics.limits(uav), topics.FAULT),
    )
    if uav == scenario.leader.id or uav in scenario.leader.successors:
        process.allow("publish", topics.EPOCH, topics.TAKEN)
        process.allow("subscribe", topics.REQUEST, topics.SETPOINT)
        process.reply.append(f"{fleet}/formation/*")
        if are_open(scenario):
            process.allow("publish", topics.SLOTS)
    return process


def _bridge(scenario: Scenario, uav: int, fleet: str) -> Enclave:
    process = Enclave(fleet, f"bridge{uav}", (f"uav{uav}/bridge",))
    process.allow(
        "publish",
        *(topics.odom(uav), topics.near(uav), topics.truth(uav), topics.track(uav)),
        *(topics.limits(uav), topics.battery(uav), topics.TF),
        *(topics.EMERGENCY, topics.LOST),
        *((topics.ORIGIN,) if uav == scenario.leader.id else ()),
    )
    others = [other for other in scenario.uav_ids if other != uav]
    process.allow(
        "subscribe",
        *(topics.velocity_setpoint(uav), topics.wrench_setpoint(uav)),
        *(topics.EPOCH, topics.TAKEN, topics.EMERGENCY, topics.ORIGIN, topics.DIAGNOSTICS),
        *map(topics.odom, others),
        *map(topics.track, others),
    )
    return process


def policy(processes: Iterable[Enclave]) -> str:
    """The policy as XML. sros2 adds the topic by which processes tell each other their nodes."""
    root = ElementTree.Element("policy", version=VERSION)
    parts = ElementTree.SubElement(root, "enclaves")
    for process in processes:
        enclave = ElementTree.SubElement(parts, "enclave", path=process.path)
        below, _, node = f"{process.fleet}/{process.nodes[0]}".rpartition("/")
        profile = ElementTree.SubElement(
            ElementTree.SubElement(enclave, "profiles"), "profile", ns=below or "/", node=node
        )
        for kind, rule in (
            ("topic", "publish"),
            ("topic", "subscribe"),
            ("service", "reply"),
            ("service", "request"),
        ):
            names = sorted(set(getattr(process, rule)))
            if names:  # a list of none is no list for sros2
                listed = ElementTree.SubElement(profile, f"{kind}s", {rule: "ALLOW"})
                for name in names:
                    ElementTree.SubElement(listed, kind).text = name
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
