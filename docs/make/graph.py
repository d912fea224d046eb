"""Publishers and subscriptions of a flight: every node is started and its topics are read."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from ptnsbc_io.bag import BagWriter
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.mavlink.transport import connect
from ptnsbc_nodes.bridge.bridge import WANTED_MESSAGES
from ptnsbc_nodes.bridge.bridge_node import BridgeNode, BridgeOptions
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import Transforms
from ptnsbc_nodes.comm.door import Door
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.comm.topics import recorded
from ptnsbc_nodes.fleet.fleet_node import LauncherNode
from ptnsbc_nodes.recording.fleet_recorder import LockstepRecorder, RealTimeRecorder
from ptnsbc_nodes.recording.recorder import BagRecorder, topic_info
from ptnsbc_nodes.runtime.environment import free_domain
from ptnsbc_nodes.sim.sim_node import sim_node
from ptnsbc_nodes.uav.uav_node import UavNode
from ptnsbc_sim.scenario import Scenario, load_scenario

REAL_TIME, LOCKSTEP, BRIDGED = "real time", "lock-step", "flight controllers"
SCENARIO = "experiment_4"  # has a truth, and a MAVLink block
_OPEN_SLOTS = {"formation.assignment": "optimal"}
_STREAM = {
    "leader.trajectory": {
        "kind": "stream",
        "position_m": [0, 0, 5],
        "low_m": [-9, -9, 1],
        "high_m": [9, 9, 9],
        "speed_m_s": 1,
        "acceleration_m_s2": 1,
    }
}
_MODES = {
    REAL_TIME: FlightOptions(recorded=True),
    LOCKSTEP: FlightOptions(lockstep=True, recorded=True),
    BRIDGED: FlightOptions(recorded=True, bridged=True),
}
_OURS = re.compile(r"^/(?:uav(\d+)|formation|diagnostics$|clock$|tf$)")


class End(NamedTuple):
    """One publisher or subscription."""

    topic: str  # with N in place of the number of a UAV
    type: str
    node: str  # uav, bridge, sim, recorder, launcher
    own: bool  # of the UAV that the topic belongs to
    leads: bool  # the leader's, where the node is of a UAV
    mode: str  # REAL_TIME, LOCKSTEP or BRIDGED
    publishes: bool
    profile: Any
    guarded: bool  # whether a subscription has a door


def ends() -> list[End]:
    """Every end of every topic of ours, in all three kinds of flight."""
    with free_domain() as domain:
        found = []
        for mode, options in _MODES.items():
            found += _flight(domain, mode, options, load_scenario(SCENARIO))
            decided = _flight(domain, mode, options, load_scenario(SCENARIO, _OPEN_SLOTS))
            found += [end for end in decided if end.topic == topics.SLOTS.name]
            streamed = _flight(domain, mode, options, load_scenario(SCENARIO, _STREAM))
            own = (topics.SETPOINT.name, topics.TAKEN.name)
            found += [end for end in streamed if end.topic in own]
        return found


def _flight(domain: int, mode: str, options: FlightOptions, scenario: Scenario) -> Iterator[End]:
    with ExitStack() as stack:
        context = stack.enter_context(_context(domain))
        edges = CommunicationGraph(scenario, options)
        made: list[tuple[str, int, Node]] = []

        def node(kind: str, uav: int = 0) -> Node:
            name = "controller" if kind == "uav" else kind
            one = rclpy.create_node(name, context=context, namespace=f"/uav{uav}" if uav else "")
            stack.callback(one.destroy_node)
            made.append((kind, uav, one))
            return one

        for uav in scenario.uav_ids:
            UavNode(node("uav", uav), scenario, uav, edges)
            if options.bridged:
                link = MavlinkLink(connect("udpout:127.0.0.1:9"), uav, WANTED_MESSAGES, None)
                stack.callback(link.close)
                BridgeNode(
                    node("bridge", uav),
                    scenario,
                    uav,
                    edges,
                    link,
                    BridgeOptions(False),
                    lambda _: None,
                )
        if not options.bridged:
            sim_node(node("sim"), scenario, edges, lambda: None)
        stack.enter_context(_recorder(node("recorder"), scenario, options))
        for leads in (True, False):
            name = "fleet" if leads else "fleet_elsewhere"
            launcher = stack.enter_context(LauncherNode(domain, name, shared=True, leads=leads))
            made.append(("launcher", 0, launcher.node))
        for kind, uav, one in made:
            yield from _ends(kind, uav, one, mode, scenario.leader.id)


@contextmanager
def _context(domain: int) -> Iterator[Context]:
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        yield context
    finally:
        rclpy.shutdown(context=context)


@contextmanager
def _recorder(node: Node, scenario: Scenario, options: FlightOptions) -> Iterator[BagRecorder]:
    uavs, lockstep = scenario.uav_ids, options.lockstep
    options_of_bag = {
        "lockstep": lockstep,
        "with_truth": not options.bridged,
        "with_slots": scenario.formation.has_open_slots,
        "with_stream": scenario.takes_setpoints,
    }
    infos = [topic_info(one, lockstep=lockstep) for one in topics.in_bag(uavs, **options_of_bag)]
    with tempfile.TemporaryDirectory() as folder, BagWriter(Path(folder) / "bag", infos) as writer:
        kind = LockstepRecorder if lockstep else RealTimeRecorder
        yield kind(node, writer, recorded(uavs, **options_of_bag), Transforms(uavs))


def _ends(kind: str, uav: int, node: Node, mode: str, leader: int) -> Iterator[End]:
    for publishes, found in ((True, node.publishers), (False, node.subscriptions)):
        for one in found:
            belongs = _OURS.match(one.topic_name)
            if not belongs:
                continue
            name = re.sub(r"^/uav\d+/", "/uavN/", one.topic_name)
            package = one.msg_type.__module__.partition(".")[0]
            kind_of_message = f"{package}/msg/{one.msg_type.__name__}"
            own = belongs[1] is not None and int(belongs[1]) == uav
            leads = uav == leader
            guarded = isinstance(getattr(one, "callback", None), Door)
            yield End(
                name, kind_of_message, kind, own, leads, mode, publishes, one.qos_profile, guarded
            )
