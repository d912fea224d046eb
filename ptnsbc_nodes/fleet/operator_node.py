"""The fleet in types of ROS, for operators and viewers: its state, legs as an action, the emergency stop as a service.

The UAVs need none of this: they speak messages that every ROS has. This node translates.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import rclpy
from ptnsbc_interfaces.action import FlyLeg
from ptnsbc_interfaces.msg import FleetState, UavState
from ptnsbc_interfaces.srv import StartLeg, Stop
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_srvs.srv import Trigger

from ptnsbc_io.wire import Diagnostics, OdometryDecoder
from ptnsbc_io.wire.cdr import split_stamp
from ptnsbc_io.wire.diagnostics import decode_diagnostics
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import decode_leg
from ptnsbc_nodes.comm.diagnostics import STATUS_HZ
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.legs import Leg
from ptnsbc_nodes.comm.qos import keep_last
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.emergency.orders import KILL, LAND, Order, runtime_folder
from ptnsbc_nodes.fleet.coordinator_node import Coordinator
from ptnsbc_nodes.fleet.emergency_stop import EmergencyStop
from ptnsbc_nodes.fleet.fleet_state import FleetReport
from ptnsbc_nodes.runtime.executor import make_executor
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.slots import are_open

STATE = "/formation/state"
START_LEG = "/formation/start_leg"
FLY_LEG = "/formation/fly_leg"
EMERGENCY_STOP = "/formation/emergency_stop"

_LEGS = ("start", "hold", "land", "stop")
_ANSWER_S = 3.0  # of the leader
_STOP_S = 10.0  # of all bridges
_LOCAL_S = 0.1  # of the bridges of this host, before the middleware is asked
_DISCOVERY_S = 1.5
_SEALED = (
    "security: signed: this interface carries no seal: use `ptnsbc stop` or the commands of ptnsbc"
)


class Answer(NamedTuple):
    """Of the leader to a call."""

    accepted: bool
    message: str


class OperatorNode:
    """Publishes the state of the fleet; passes legs on to the leader and emergency stops on to the bridges."""

    def __init__(self, node: Node, scenario: Scenario, domain: int, seal: Seal | None) -> None:
        """`seal` of the fleet: with one the node only tells, because its services carry none."""
        self._node = node
        self._scenario = scenario
        self._signed = seal is not None
        self._endpoints = Endpoints(node, lockstep=False, seal=seal)
        self._domain = domain
        self._folder = runtime_folder(domain, self._endpoints.fleet)
        self.report = FleetReport(scenario)
        self._goals: list[_Goal] = []  # that are flown
        self._listen()
        fleet = self._endpoints.fleet
        self._publish = node.create_publisher(
            FleetState, fleet + STATE, keep_last(10, reliable=True)
        ).publish
        # A callback of this node waits for answers of the leader: another node's executor receives them.
        self._caller = rclpy.create_node(
            "operator_calls",
            namespace=node.get_namespace(),
            context=node.context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._calls: Any = make_executor(node.context)
        self._calls.add_node(self._caller)
        self._leader = {
            name: self._caller.create_client(Trigger, f"{fleet}/formation/{name}") for name in _LEGS
        }
        node.create_service(StartLeg, fleet + START_LEG, self._on_start_leg)
        node.create_service(Stop, fleet + EMERGENCY_STOP, self._on_stop)
        self._action = ActionServer(
            node,
            FlyLeg,
            fleet + FLY_LEG,
            lambda goal: FlyLeg.Result(),
            handle_accepted_callback=self._on_goal,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(1.0 / STATUS_HZ, self._on_timer, clock=steady)

    def flush(self, timeout_s: float) -> None:
        """As the process wants it at its end."""
        self._endpoints.flush(timeout_s)

    def account(self) -> str:
        """What was sent."""
        return self._endpoints.account()

    def close(self) -> None:
        """Remove everything from the node."""
        self._action.destroy()
        self._endpoints.close()
        self._calls.shutdown()
        self._caller.destroy_node()

    def _listen(self) -> None:
        listen, report = self._endpoints.listen, self.report
        listen(topics.EPOCH, decode_leg, report.on_epoch, required=False)
        if are_open(self._scenario):
            listen(topics.SLOTS, report.slots.decode, report.on_slots, required=False)
        reliable = keep_last(50, reliable=True)
        for topic in (topics.DIAGNOSTICS, topics.READY):
            listen(topic, decode_diagnostics, self._on_status, required=False, profile=reliable)
        for uav in self._scenario.uav_ids:
            on_odometry = partial(report.on_odometry, uav)
            listen(topics.odom(uav), OdometryDecoder(), on_odometry, required=False)

    def _on_status(self, array: Diagnostics) -> None:
        self.report.on_status(array, time.monotonic())

    def _on_timer(self) -> None:
        self._publish(self.state())
        self._goals = [goal for goal in self._goals if not goal.look()]

    def state(self) -> FleetState:
        """The fleet now."""
        report, now_s = self.report, time.monotonic()
        errors, leg = report.errors_m(), report.leg
        state = FleetState(
            share_of_time=report.share_of_time(),
            worst_error_m=max(errors.values(), default=math.nan),
            not_in_place=report.not_in_place(errors, now_s),
        )
        stamp = state.header.stamp
        stamp.sec, stamp.nanosec = split_stamp(max(report.now_ns, 0))
        if leg is not None:
            state.leg.name, state.leg.predefined_time_s = leg.name, report.predefined_time_s
            state.leg.epoch.sec, state.leg.epoch.nanosec = split_stamp(leg.t0_ns)
        for uav in report.uavs.values():
            silent = report.is_silent(uav.id, now_s)
            in_formation = uav.id in errors and not silent
            state.uavs.append(
                UavState(
                    id=uav.id,
                    level=UavState.STALE if silent else uav.level,
                    reason="no status" if silent else uav.reason,
                    mode=uav.mode,
                    ready=uav.ready and not silent,
                    formation_error_m=errors.get(uav.id, math.nan),
                    in_place=in_formation and uav.id not in state.not_in_place,
                    avoidance_active_s=uav.avoidance_active_s,
                    holding_s=uav.holding_s,
                    vehicle=uav.vehicle,
                )
            )
        return state

    def leader_is_there(self) -> bool:
        """Whether every service of the leader has been found."""
        return all(client.service_is_ready() for client in self._leader.values())

    def call(self, name: str) -> Answer:
        """Call the leader's service of a leg; waits for the answer."""
        if self._signed:
            return Answer(False, _SEALED)
        if name not in self._leader:
            return Answer(False, f"leg {name[:40]!r}: expected one of {', '.join(_LEGS)}")
        client = self._leader[name]
        if not client.service_is_ready():
            return Answer(False, f"the leader's service {client.srv_name} is not there")
        call = client.call_async(Trigger.Request())
        self._calls.spin_until_future_complete(call, timeout_sec=_ANSWER_S)
        if not call.done():
            client.remove_pending_request(call)
            return Answer(False, "the leader does not answer")
        response = call.result()
        return Answer(bool(response.success), str(response.message))

    def _on_start_leg(self, request: Any, response: Any) -> Any:
        response.accepted, response.message = self.call(request.leg)
        return response

    def _on_goal(self, goal: ServerGoalHandle) -> None:
        self._goals.append(_Goal(self, goal))

    def fill(self, message: Any) -> None:
        """Worst error and who is not in place, into feedback or result."""
        errors = self.report.errors_m()
        message.worst_error_m = max(errors.values(), default=math.nan)
        message.not_in_place = self.report.not_in_place(errors, time.monotonic())

    def _on_stop(self, request: Any, response: Any) -> Any:
        """As `ptnsbc stop`: on every path until each bridge has answered."""
        if self._signed:
            response.vehicles = [_SEALED]
            return response
        order = Order(KILL if request.kill else LAND, request.all)
        operation = EmergencyStop(self._folder, order)
        try:
            operation.begin()
            operation.run(_LOCAL_S)  # the bridges of this host need not wait for the middleware
            with Coordinator(self._domain, "operator_stop", self._endpoints.fleet) as coordinator:
                operation.remote = coordinator
                operation.discover(_DISCOVERY_S)
                if not operation.bridges:  # a simulated fleet
                    return self._tell_leader(response, kill=request.kill)
                response.success = operation.run(_STOP_S)
            response.vehicles = [f"{one.name}: {one.text}" for one in operation.outcomes()]
        finally:
            operation.close()
        return response

    def _tell_leader(self, response: Any, *, kill: bool) -> Any:
        answer = self.call("stop")
        response.success = answer.accepted and not kill
        motors = "; a simulated fleet has no motors to stop" if kill else ""
        response.vehicles = [f"leader: {answer.message}{motors}"]
        return response


class _Goal:
    """A leg that is flown for a client of the action: until its predefined time, another leg or a cancel request.

    The goal's `execute` runs only at the end, for the result: it would hold or burn the one thread of the node.
    """

    def __init__(self, operator: OperatorNode, goal: ServerGoalHandle) -> None:
        self._operator, self._goal = operator, goal
        self._before = operator.report.leg
        self._own: Leg | None = None
        self._answer = operator.call(goal.request.leg)
        self._heard_s = time.monotonic()

    def look(self) -> bool:
        """Publish the feedback; whether the goal has ended."""
        goal, report, now_s = self._goal, self._operator.report, time.monotonic()
        if not self._answer.accepted:
            return self._end("abort", self._answer.message)
        if goal.is_cancel_requested:
            return self._end("canceled", f"hold: {self._operator.call('hold').message}")
        if not report.is_silent(report.leader, now_s):
            self._heard_s = now_s
        elif now_s > self._heard_s + _ANSWER_S:
            return self._end("abort", "the leader is silent")
        return self._follow(report)

    def _follow(self, report: FleetReport) -> bool:
        """Look at the leg that the leader accepted."""
        leg = report.leg
        if self._own is None and leg != self._before:
            self._own = leg
        if self._own is None:
            return False
        if leg != self._own:
            return self._end("abort", f"another leg has begun: {leg.name if leg else 'none'}")
        feedback = FlyLeg.Feedback(share_of_time=report.share_of_time())
        self._operator.fill(feedback)
        self._goal.publish_feedback(feedback)
        if not report.predefined_time_s:
            return self._end("succeed", f"leg {self._own.name}: it has begun")
        return feedback.share_of_time >= 1.0 and self._judge(feedback.not_in_place)

    def _judge(self, late: Sequence[int]) -> bool:
        time_s = self._operator.report.predefined_time_s
        if late:
            names = ", ".join(f"uav{uav}" for uav in late)
            return self._end("abort", f"not in place after {time_s:g} s: {names}")
        return self._end("succeed", f"in place after {time_s:g} s")

    def _end(self, how: str, message: str) -> bool:
        result = FlyLeg.Result(success=how == "succeed", message=message)
        self._operator.fill(result)

        def execute(goal: ServerGoalHandle) -> Any:
            getattr(goal, how)()
            return result

        self._goal.execute(execute)
        return True
