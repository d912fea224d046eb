"""The policy of a fleet for sros2: the topics and services of each process, by the edges of the scenario, and no more.

`ros2 security generate_artifacts -k KEYSTORE -p POLICY` makes a keystore of it. The form is version 0.2.0 of sros2's
`policy.xsd`: an enclave for each process, with the profile of its node. A `*` in a name stands for any characters,
slashes included.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Literal, NamedTuple
from xml.etree import ElementTree

from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.topics import Topic
from ptnsbc_sim.scenario import Scenario

VERSION = "0.2.0"
FLEET, OPERATOR = "fleet", "operator"
"""Enclaves of the launcher, and of what an operator runs beside it: `ptnsbc stop`, `view`, `mission`, ros2, RViz."""
_OPERATORS_NODES = ("operator*", "stop_*", "mission_*", "view*", "_ros2cli*")
_ORDERS = (topics.REQUEST, topics.LOST, topics.EMERGENCY)


class Enclave(NamedTuple):
    """One process of a fleet, and what it may use: topics, and names of ROS, below the fleet unless they begin with /.

    Every node also has parameters, a log and a status.
    """

    name: str
    nodes: tuple[str, ...]
    publish: tuple[Topic | str, ...]
    subscribe: tuple[Topic | str, ...]
    reply: tuple[str, ...] = ()  # services that it offers
    request: tuple[str, ...] = ()  # services that it calls


def enclaves(
    scenario: Scenario, edges: CommunicationGraph, backend: Literal["sim", "mavlink"]
) -> Iterator[Enclave]:
    """Each process of a fleet, with what it may use; `edges` of the scenario say who hears whom."""
    ids = scenario.uav_ids
    for uav in ids:
        yield _uav(scenario, edges, uav)
        if backend == "mavlink":
            yield _bridge(scenario, uav)
    odometry = tuple(map(topics.odom, ids))
    if backend == "sim":
        sensed = (topic(uav) for uav in ids for topic in (topics.near, topics.truth))
        yield Enclave(
            topics.SIM,
            ("sim",),
            publish=(topics.CLOCK, topics.TF, topics.MARKERS, *odometry, *sensed),
            subscribe=(topics.EPOCH, topics.RECORDED, *map(topics.wrench_setpoint, ids)),
        )
    every = topics.recorded(ids, lockstep=False, with_truth=True, with_slots=True, with_stream=True)
    yield Enclave(topics.RECORDER, ("recorder",), publish=(topics.RECORDED,), subscribe=every)
    reports = (topics.DIAGNOSTICS, topics.READY, topics.OVER, topics.EPOCH)
    yield Enclave(
        FLEET,
        ("fleet*",),  # launchers on several computers differ in name
        publish=(topics.OVER, *_ORDERS),
        subscribe=(topics.REQUEST, *reports, *odometry),
        reply=("formation/arm",),
        request=("formation/*",),
    )
    yield Enclave(  # reads everything, orders, and offers the fleet in the types of ptnsbc_interfaces
        OPERATOR,
        _OPERATORS_NODES,
        publish=(
            *(topics.SETPOINT, *_ORDERS),
            *("formation/state", "formation/announced", "formation/*/_action/*"),
        ),
        subscribe=("*", "/tf", "/rosout"),
        reply=("formation/*",),
        request=("*",),
    )


def _uav(scenario: Scenario, edges: CommunicationGraph, uav: int) -> Enclave:
    leads = uav == scenario.leader.id or uav in scenario.leader.successors
    of_leader = (
        topics.EPOCH,
        topics.TAKEN,
        *((topics.SLOTS,) if scenario.formation.has_open_slots else ()),
    )
    return Enclave(
        f"uav{uav}",
        (f"uav{uav}/controller",),
        publish=(
            *(topics.formation_state(uav), topics.leader_estimate(uav)),
            *(topics.velocity_setpoint(uav), topics.wrench_setpoint(uav)),
            *(*topics.notes(uav), topics.robot_description(uav)),
            *(of_leader if leads else ()),
        ),
        subscribe=(
            *(*edges.heard_by(uav), topics.limits(uav)),
            *((topics.REQUEST, topics.SETPOINT) if leads else ()),
        ),
        reply=("formation/*",) if leads else (),
    )


def _bridge(scenario: Scenario, uav: int) -> Enclave:
    others = [other for other in scenario.uav_ids if other != uav]
    return Enclave(
        f"bridge{uav}",
        (f"uav{uav}/bridge",),
        publish=(
            *(topics.odom(uav), topics.near(uav), topics.truth(uav), topics.track(uav)),
            *(topics.limits(uav), topics.battery(uav), topics.TF),
            *(topics.EMERGENCY, topics.LOST),
            *((topics.ORIGIN,) if uav == scenario.leader.id else ()),
        ),
        subscribe=(
            *(topics.velocity_setpoint(uav), topics.wrench_setpoint(uav)),
            *(topics.EPOCH, topics.TAKEN, topics.EMERGENCY, topics.ORIGIN, topics.DIAGNOSTICS),
            *map(topics.odom, others),
            *map(topics.track, others),
        ),
    )


def policy(processes: Iterable[Enclave], fleet: str = "") -> str:
    """The policy of a fleet as XML; `fleet` is its namespace, "/blue", or empty.

    A process is started with `--enclave` and the path of its enclave, "/blue/uav1". sros2 adds the topic by which
    processes tell each other their nodes.
    """

    def full(name: Topic | str) -> str:
        if isinstance(name, Topic):  # only /tf is common to all fleets
            return name.name if name is topics.TF else fleet + name.name
        return name if name.startswith("/") else f"{fleet}/{name}"

    root = ElementTree.Element("policy", version=VERSION)
    parts = ElementTree.SubElement(root, "enclaves")
    for process in processes:
        enclave = ElementTree.SubElement(parts, "enclave", path=f"{fleet}/{process.name}")
        below, _, node = f"{fleet}/{process.nodes[0]}".rpartition("/")
        profile = ElementTree.SubElement(
            ElementTree.SubElement(enclave, "profiles"), "profile", ns=below or "/", node=node
        )
        status = (topics.DIAGNOSTICS, topics.READY, "/rosout", "/parameter_events")
        heard = (topics.LOST, topics.CLOCK, "/parameter_events")
        for kind, rule, names in (
            ("topic", "publish", (*process.publish, *status)),
            ("topic", "subscribe", (*process.subscribe, *heard)),
            ("service", "reply", (*process.reply, *(f"{node}/*" for node in process.nodes))),
            ("service", "request", process.request),
        ):
            if names:  # a list of none is no list for sros2
                listed = ElementTree.SubElement(profile, f"{kind}s", {rule: "ALLOW"})
                for name in sorted(set(map(full, names))):
                    ElementTree.SubElement(listed, kind).text = name
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
