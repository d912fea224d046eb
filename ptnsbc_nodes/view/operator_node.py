"""The fleet in types of ROS, for operators and viewers: its state, legs and missions as actions, the emergency stop.

The UAVs need none of this: they speak messages that every ROS has. This node translates.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import rclpy
from ptnsbc_interfaces.action import FlyLeg, FlyMission
from ptnsbc_interfaces.msg import Emergency, Epoch, FleetState, Limits, UavState
from ptnsbc_interfaces.srv import Arm, StartLeg, Stop
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_srvs.srv import Trigger

from ptnsbc_io.wire import HeaderFields
from ptnsbc_io.wire.cdr import split_stamp
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import ARM_SERVICE, decode_leg
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.qos import keep_last
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.vehicle_messages import PlannerLimits, decode_limits, limited
from ptnsbc_nodes.emergency.orders import APART, KILL, LAND, Order, parse_order, runtime_folder
from ptnsbc_nodes.fleet.emergency_stop import EmergencyStop
from ptnsbc_nodes.fleet.fleet_node import Answer, LauncherNode
from ptnsbc_nodes.runtime.node_process import make_executor
from ptnsbc_nodes.uav.leg_services import CANCEL_SERVICE, leg_service
from ptnsbc_nodes.view.flight_state import FlightState
from ptnsbc_nodes.view.goals import LegGoal, MissionGoal
from ptnsbc_nodes.view.observer import FleetListener
from ptnsbc_sim.counters import STATUS_HZ
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.constants import agent_config
from ptnsbc_sim.scenario.mission.legs import CANCEL, leg_names, number_of

STATE = "/formation/state"
ANNOUNCED = "/formation/announced"
ARM_VEHICLES = "/formation/arm_vehicles"
START_LEG = "/formation/start_leg"
FLY_LEG = "/formation/fly_leg"
FLY_MISSION = "/formation/fly_mission"
EMERGENCY_STOP = "/formation/emergency_stop"

_LEGS = ("start", "hold", "land", "stop")
_ANSWER_S = 3.0  # of the leader to a call
_STOP_S = 10.0  # of all bridges
_LOCAL_S = 0.1  # of the bridges of this host, before the middleware is asked
_DISCOVERY_S = 1.5
_MOST_EPOCHS = 64  # that a node which joins late is told
_ORDERS = {APART: Emergency.APART, LAND: Emergency.LAND, KILL: Emergency.KILL}
_NOT_HEARD = {"silent": True, "level": 0, "word": "nothing was heard"}
_SEALED = (
    "security: signed: this interface carries no seal: use `ptnsbc stop` or the commands of ptnsbc"
)


class OperatorNode:
    """Publishes the state of the fleet; passes legs on to the leader and emergency stops on to the bridges."""

    def __init__(self, node: Node, scenario: Scenario, domain: int, seal: Seal | None) -> None:
        """`seal` of the fleet: with one the node only tells, because its services carry none."""
        self._node = node
        self._signed = seal is not None
        self.endpoints = Endpoints(node, lockstep=False, seal=seal)
        self._domain = domain
        self._folder = runtime_folder(domain, self.endpoints.fleet)
        self.flight = FlightState(scenario, time.monotonic)
        self._tolerance_m = float(scenario.formation.tolerance_m)
        self._configs = {uav: agent_config(scenario, uav) for uav in scenario.uav_ids}
        self._goals: list[LegGoal | MissionGoal] = []  # that are flown
        self._listener = FleetListener(self.endpoints, self.flight)
        fleet = self.endpoints.fleet
        self._publish = node.create_publisher(
            FleetState, fleet + STATE, keep_last(10, reliable=True)
        ).publish
        self._announce = node.create_publisher(
            Epoch, fleet + ANNOUNCED, keep_last(_MOST_EPOCHS, reliable=True, latched=True)
        ).publish
        self.endpoints.listen(topics.EPOCH, decode_leg, self._on_epoch, required=False)
        self.calls = FleetCalls(node, scenario, fleet, signed=seal is not None)
        node.create_service(Arm, fleet + ARM_VEHICLES, self._on_arm)
        node.create_service(StartLeg, fleet + START_LEG, self._on_start_leg)
        node.create_service(Stop, fleet + EMERGENCY_STOP, self._on_stop)
        self._actions = [
            ActionServer(
                node,
                action,
                fleet + name,
                lambda _goal: None,  # each goal executes with its own result
                handle_accepted_callback=partial(self._follow, kind, call),
                cancel_callback=lambda _goal: CancelResponse.ACCEPT,
            )
            for action, name, kind, call in (
                (FlyLeg, FLY_LEG, LegGoal, self.calls.begin),
                (FlyMission, FLY_MISSION, MissionGoal, self.calls.call),
            )
        ]
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(1.0 / STATUS_HZ, self._on_timer, clock=steady)

    def _follow(self, kind: Any, call: Callable[[str], Answer], goal: ServerGoalHandle) -> None:
        self._goals.append(kind(self.flight, call, goal))

    def close(self) -> None:
        """Remove everything from the node."""
        for action in self._actions:
            action.destroy()
        self.endpoints.close()
        self.calls.close()

    def _on_timer(self) -> None:
        if self._listener.look():
            for uav in self._configs:
                # As with odometry: before the start its bridge waits for its planner, and for no viewer.
                take = partial(self._on_limits, uav)
                self.endpoints.listen(topics.limits(uav), decode_limits, take, required=False)
        state = self._fleet_state()
        self._publish(state)
        self._goals = [goal for goal in self._goals if not goal.look(state)]

    def _on_epoch(self, leg: HeaderFields) -> None:
        number = number_of(leg.frame_id)
        mission = self.flight.scenario.mission
        names = [] if mission is None else leg_names(mission)
        epoch = Epoch(leg=leg.frame_id)
        if number == CANCEL:
            epoch.leg = CANCEL_SERVICE
        elif number is not None:
            if number > len(names):
                return
            epoch.leg, epoch.number = names[number - 1], number
        epoch.epoch.sec, epoch.epoch.nanosec = split_stamp(leg.stamp_ns)
        self._announce(epoch)

    def _on_limits(self, uav: int, limits: PlannerLimits) -> None:
        self._configs[uav] = limited(self._configs[uav], *limits)

    def _fleet_state(self) -> FleetState:
        frame, leg = self.flight.frame(), self.flight.leg
        in_formation = frame["left_s"] is not None
        said = {one["name"]: one for one in frame["processes"]}
        state = FleetState()
        state.header.stamp.sec, state.header.stamp.nanosec = split_stamp(
            max(self.flight.stamp_ns, 0)
        )
        if leg is not None:
            state.leg.name = leg.name
            state.leg.epoch.sec, state.leg.epoch.nanosec = split_stamp(leg.t0_ns)
        if in_formation:
            time_s = frame["since_s"] + frame["left_s"]
            state.leg.predefined_time_s = time_s
            state.share_of_time = min(max(frame["since_s"] / time_s, 0.0), 1.0)
        for one in frame["uavs"]:
            uav = self._uav_state(one, said.get(f"uav{one['id']}"), in_formation=in_formation)
            state.uavs.append(uav)
            if in_formation and not uav.in_place:
                state.not_in_place.append(uav.id)
        errors = (uav.formation_error_m for uav in state.uavs)
        state.worst_error_m = max(filter(math.isfinite, errors), default=math.nan)
        return state

    def _uav_state(
        self, one: Mapping[str, Any], said: Mapping[str, Any] | None, *, in_formation: bool
    ) -> UavState:
        said = said or _NOT_HEARD
        error = one["error"] if in_formation and one["error"] is not None else math.nan
        near, battery = one["near"], one["battery"]
        limits, order = self._configs[one["id"]].filter, parse_order(one["order"] or "")
        return UavState(
            id=one["id"],
            level=UavState.STALE if said["silent"] else said["level"],
            reason=said["word"],
            mode=one["mode"] or "",
            formation_error_m=error,
            in_place=not said["silent"] and error <= self._tolerance_m,
            nearest="" if near is None else near["name"],
            room_m=math.nan if near is None else near["room"],
            vehicle=one["vehicle"] or "",
            armed=bool(one["armed"]),
            battery_percent=-1 if battery is None else min(battery, 100),
            limits=Limits(speed_m_s=limits.max_speed, acceleration_m_s2=limits.max_acceleration),
            emergency=Emergency(
                order=Emergency.NONE if order is None else _ORDERS[order.what],
                all=order is not None and order.pilots_too,
            ),
        )

    def _on_arm(self, _request: Any, response: Any) -> Any:
        response.accepted, response.message = self.calls.arm()[:2]
        return response

    def _on_start_leg(self, request: Any, response: Any) -> Any:
        response.accepted, response.message = self.calls.begin(request.leg)[:2]
        return response

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
            with LauncherNode(self._domain, "operator_stop", self.endpoints.fleet) as node:
                operation.remote = node
                operation.discover(_DISCOVERY_S)
                if not operation.bridges:  # a simulated fleet
                    answer = self.calls.call("stop")
                    response.success = answer.accepted and not request.kill
                    motors = "; a simulated fleet has no motors to stop" if request.kill else ""
                    response.vehicles = [f"leader: {answer.message}{motors}"]
                    return response
                response.success = operation.run(_STOP_S)
            response.vehicles = [f"{one.name}: {one.text}" for one in operation.outcomes()]
        finally:
            operation.close()
        return response


class FleetCalls:
    """Calls of the services of the leader and of the launcher, from within a callback of another node."""

    def __init__(self, node: Node, scenario: Scenario, fleet: str, *, signed: bool) -> None:
        """`signed`: every call is refused, because these carry no seal."""
        self._signed = signed
        # A callback waits for these answers: another node's executor receives them.
        self._node = rclpy.create_node(
            "operator_calls",
            namespace=node.get_namespace(),
            context=node.context,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._executor: Any = make_executor(node.context)
        self._executor.add_node(self._node)
        mission = scenario.mission
        legs = 0 if mission is None else len(mission.legs)
        words = [CANCEL_SERVICE, *map(leg_service, range(2, legs + 1))] if legs else []
        self._clients = {
            name: self._node.create_client(Trigger, f"{fleet}/formation/{name}")
            for name in (*_LEGS, *words, ARM_SERVICE)
        }

    def are_there(self) -> bool:
        """True if every service has been found."""
        return all(client.service_is_ready() for client in self._clients.values())

    def begin(self, name: str) -> Answer:
        """Let the leader begin a leg of `_LEGS`."""
        if name not in _LEGS and not self._signed:
            return Answer(False, f"leg {name[:40]!r}: expected one of {', '.join(_LEGS)}")
        return self.call(name)

    def arm(self) -> Answer:
        """Have the launcher let the vehicles arm."""
        return self.call(ARM_SERVICE, "launcher")

    def call(self, name: str, who: str = "leader") -> Answer:
        """Call a service; waits for the answer."""
        if self._signed:
            return Answer(False, _SEALED)
        client = self._clients[name]
        if not client.service_is_ready():
            return Answer(False, f"the {who}'s service {client.srv_name} is not there")
        call = client.call_async(Trigger.Request())
        self._executor.spin_until_future_complete(call, timeout_sec=_ANSWER_S)
        if not call.done():
            client.remove_pending_request(call)
            return Answer(False, f"the {who} does not answer")
        response = call.result()
        return Answer(bool(response.success), str(response.message))

    def close(self) -> None:
        """Leave."""
        self._executor.shutdown()
        self._node.destroy_node()
