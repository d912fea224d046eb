"""A fleet that the test plays, and a client of the operator's interface."""

from __future__ import annotations

import threading

import numpy as np
from ptnsbc_interfaces.action import FlyLeg, FlyMission
from ptnsbc_interfaces.msg import Epoch, FleetState
from rclpy.action import ActionClient
from std_srvs.srv import Trigger

from ptnsbc_io.wire import HeaderTemplate, OdometryTemplate
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.qos import keep_last
from ptnsbc_nodes.view.operator_node import (
    ANNOUNCED,
    FLY_LEG,
    FLY_MISSION,
    STATE,
    OperatorNode,
)

T0_S = 100.0


def send_mission(ros):
    """Ask a fleet to fly its mission from the start: the first feedback, or the result when there is none."""
    told = []
    try:
        action = ActionClient(ros.node("client"), FlyMission, FLY_MISSION)
        ros.spin_until(action.server_is_ready)
        sent = action.send_goal_async(
            FlyMission.Goal(from_leg=0), feedback_callback=lambda one: told.append(one.feedback)
        )
        ros.spin_until(sent.done)
        sent.result().get_result_async().add_done_callback(lambda end: told.append(end.result()))
        ros.spin_until(lambda: told)
        return told[0]
    finally:
        ros.close()


class Fleet:
    """UAVs whose leader answers, and a client of the operator's interface."""

    def __init__(self, ros, scenario, seal=None):
        self.ros, self.scenario = ros, scenario
        others = ros.node("others")
        ends = Endpoints(others, lockstep=False, seal=seal)
        self.limits = {uav: ends.publisher(topics.limits(uav), 0) for uav in scenario.uav_ids}
        self.odom = {uav: ends.publisher(topics.odom(uav), 0) for uav in scenario.uav_ids}
        self.status = ends.publisher(topics.DIAGNOSTICS, 0)
        self.epoch = ends.publisher(topics.EPOCH, 0)
        heard = ends.readers(topics.DIAGNOSTICS), ends.readers(topics.EPOCH)
        self.answers, self.asked = {}, []
        self._serve_leader(type(ros)(ros.domain))
        self.operator = OperatorNode(ros.node("operator"), scenario, ros.domain, seal)
        self.client = ros.node("client")
        self.states, self.feedback, self.epochs = [], [], []
        self.client.create_subscription(FleetState, STATE, self.states.append, 10)
        latched = keep_last(10, reliable=True, latched=True)
        self.client.create_subscription(Epoch, ANNOUNCED, self.epochs.append, latched)
        self.action = ActionClient(self.client, FlyLeg, FLY_LEG)
        self.missions = ActionClient(self.client, FlyMission, FLY_MISSION)
        self.at_s, self.off, self.orders = T0_S, {}, {}  # of the bridges, by UAV
        ros.spin_until(
            lambda: all(readers() for readers in heard) and self.action.server_is_ready()
        )
        ros.spin_until(self.missions.server_is_ready)

    def _serve_leader(self, leader):
        """In a thread of its own: the operator's node waits for its answers."""
        node = leader.node("leader")
        mission = self.scenario.mission
        legs = [f"leg_{n}" for n in range(2, len(mission.legs) + 1)] if mission else []
        for name in (
            "arm",
            "start",
            "hold",
            "land",
            "stop",
            *(["cancel", *legs] if mission else []),
        ):
            node.create_service(Trigger, f"/formation/{name}", self.answer(name))
        self._over = threading.Event()

        def serve():
            while not self._over.is_set():
                leader.spin_for(0.02)
            leader.close()

        self._thread = threading.Thread(target=serve)
        self._thread.start()

    def answer(self, name):
        def on_request(_request, response):
            self.asked.append(name)
            response.success, response.message = self.answers.get(name, (True, f"leg {name}"))
            return response

        return on_request

    def tell(self, seconds, silent=()):
        """Every UAV is in its place, but for what is `off`, so long after the epoch."""
        self.at_s = T0_S + seconds
        stamp_ns = round(self.at_s * 1e9)
        for uav in self.scenario.uav_ids:
            values = np.zeros(13)
            values[:3] = self.scenario.offset(uav) + self.off.get(uav, 0.0)
            values[6] = 1.0
            self.odom[uav](OdometryTemplate("world", f"uav{uav}").encode(stamp_ns, values))
            if uav not in silent:
                told = {"ready": "true", "waiting_for": "", "mode": "form"}
                self.status(diagnostics(0, f"uav{uav}: planner", DiagnosticLevel.OK, "", told))
        for uav, order in self.orders.items():
            link = {"armed": "true", "mode": "OFFBOARD", "order": order}
            self.status(diagnostics(0, f"bridge{uav}: vehicle", DiagnosticLevel.OK, "", link))

    def spin_until_told(self, condition, seconds, **more):
        def told():
            self.tell(seconds, **more)
            return condition()

        self.ros.spin_until(told)

    def announce(self, leg, seconds=0.0):
        self.epoch(HeaderTemplate(leg).encode(round((T0_S + seconds) * 1e9)))

    def goal(self, leg):
        return self.send(self.action, FlyLeg.Goal(leg=leg))

    def mission(self, from_leg=0):
        return self.send(self.missions, FlyMission.Goal(from_leg=from_leg))

    def send(self, action, goal):
        sent = action.send_goal_async(
            goal, feedback_callback=lambda one: self.feedback.append(one.feedback)
        )
        self.ros.spin_until(sent.done)
        result = sent.result().get_result_async()
        return sent.result(), result

    def call(self, kind, name, request):
        client = self.client.create_client(kind, name)
        self.ros.spin_until(client.service_is_ready)
        call = client.call_async(request)
        self.ros.spin_until(call.done)
        return call.result()

    def close(self):
        self.operator.close()
        self._over.set()
        self._thread.join()
