"""The surroundings of one UAV node: its sim, its neighbours and its launcher, played by a test."""

import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.comm.topics import LOST, READY
from ptnsbc_nodes.uav.uav_node import UavNode

FOLLOWER, PARENT, LEADER, NEIGHBOURS = 3, 2, 1, (2, 4)


def body(number: int) -> np.ndarray:
    odometry = np.zeros(13)
    odometry[0:3] = number, 0.5 * number, 1.0
    odometry[6] = 1.0
    return odometry


class Others:
    """Everybody that one UAV talks to: sends what it hears, keeps what it says."""

    def __init__(self, ros, scenario, uav_id, *, lockstep=True):
        self.ros, self.scenario, self.uav_id = ros, scenario, uav_id
        node = ros.node("others", namespace="/uav2")  # viewers do not count among the readers
        self.node = node
        ends = Endpoints(node, lockstep)
        edges = CommunicationGraph(scenario, FlightOptions(lockstep=lockstep))
        senders = edges.senders(uav_id)
        self.send_odom = ends.publisher(topics.odom(uav_id), 1)
        self.send_near = ends.publisher(topics.near(uav_id), 1)
        self.send_state = {i: ends.publisher(topics.formation_state(i), 1) for i in senders.states}
        self.send_estimate = {
            i: ends.publisher(topics.leader_estimate(i), 1) for i in senders.estimators
        }
        self.lose = ends.publisher(LOST, 1)
        self.announce = None if uav_id == LEADER else ends.publisher(topics.EPOCH, 1)
        self.wrenches, self.states, self.status, self.epochs = [], [], [], []
        listen = ends.listen
        listen(topics.wrench_setpoint(uav_id), bytes, self.keep(self.wrenches, wire.decode_wrench))
        listen(topics.formation_state(uav_id), bytes, self.keep(self.states, wire.decode_odometry))
        for topic, heard in (
            (topics.formation_state(uav_id), 1),
            (topics.leader_estimate(uav_id), 0),
        ):
            for _ in range(edges.readers(topic) - heard):
                listen(topic, bytes, lambda data: None)
        listen(topics.velocity_setpoint(uav_id), bytes, lambda data: None)
        for topic in (topics.DIAGNOSTICS, READY):
            listen(topic, bytes, self.keep(self.status, decode_status), required=topic is not READY)
        if uav_id == LEADER:
            listen(topics.EPOCH, bytes, self.keep(self.epochs, wire.decode_header))
            for _ in range(3):  # with the leader itself all UAVs, but no sim
                listen(topics.EPOCH, bytes, lambda data: None)
        self.template = wire.OdometryTemplate("vicon", "drone")  # of its own odometry: any frames
        self.uav = UavNode(
            ros.node("controller", namespace=f"/uav{uav_id}"), scenario, uav_id, edges
        )
        self.uav.start()
        ros.spin_until(lambda: not ends.unread() and not ends.unheard())

    @staticmethod
    def keep(where, decode):
        return lambda data: where.append(decode(data))

    def odom(self, stamp_ns):
        self.send_odom(self.template.encode(stamp_ns, body(self.uav_id)))

    def fly(self, ros):
        """Odometry of now until the first setpoint: one message alone may be stale when a full machine reads it."""

        def flying():
            self.odom(time.time_ns())
            return self.wrenches

        ros.spin_until(flying)

    def near(self, stamp_ns, rows=()):
        rows = np.array(rows, dtype=float).reshape(-1, 8)
        self.send_near(wire.encode_near(stamp_ns, "map", rows))

    def neighbours(self, stamp_ns, without=()):
        for kind, frame in ((self.send_state, "uav{}/base_link"), (self.send_estimate, "map")):
            for i, send in kind.items():
                if i not in without:
                    template = wire.OdometryTemplate("map", frame.format(i))
                    send(template.encode(stamp_ns, body(i)))

    def form(self, stamp_ns=0, leg="form"):
        self.announce(wire.HeaderTemplate(leg).encode(stamp_ns))

    def settle(self):
        """Let everything sent so far arrive and be answered."""
        self.ros.spin_for(0.1)

    def ticks(self):
        return [wrench.stamp_ns // self.scenario.timing.dt_ns for wrench in self.wrenches]

    def newest(self):
        self.status.clear()
        self.ros.spin_until(lambda: self.status)
        return self.status[-1]


def decode_status(data):
    (status,) = deserialize_message(data, DiagnosticArray).status
    return status.level, status.message, {pair.key: pair.value for pair in status.values}


def call(ros, node, name):
    client = node.create_client(Trigger, f"/formation/{name}")
    ros.spin_until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    ros.spin_until(future.done)
    return future.result()
