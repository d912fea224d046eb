"""The fleet in types of ROS, for operators and viewers: its state, legs and missions as actions, the emergency stop.

The UAVs need none of this: they speak messages that every ROS has. This node translates.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from ptnsbc_interfaces.action import FlyLeg, FlyMission
from ptnsbc_interfaces.msg import Emergency, Epoch, FleetState, LegOutcome, Limits, UavState
from ptnsbc_interfaces.srv import Arm, StartLeg, Stop
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ptnsbc_core.nanoseconds import seconds
from ptnsbc_io.cdr import split_stamp
from ptnsbc_io.wire import HeaderFields
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import ARM_SERVICE, decode_leg
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.legs import Leg
from ptnsbc_nodes.comm.qos import keep_last
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.vehicle_messages import decode_limits
from ptnsbc_nodes.emergency import APART, KILL, LAND, Order, parse_order, runtime_folder
from ptnsbc_nodes.fleet.emergency_stop import EmergencyStop
from ptnsbc_nodes.fleet.fleet_node import Answer, FleetNode, LauncherNode, LeaderClient, not_there
from ptnsbc_nodes.uav.leg_services import CANCEL_SERVICE, leg_service
from ptnsbc_nodes.view.flight_state import FlightState
from ptnsbc_nodes.view.observer import FleetListener
from ptnsbc_sim.counters import STATUS_HZ
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.constants import PlannerLimits, agent_config
from ptnsbc_sim.scenario.mission.legs import CANCEL, LandLeg, ScheduledLeg, leg_names, number_of

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
_SILENT_S = 3.0  # of the leader, which ends a goal
_LATE_S = 0.5  # of the flight: a state that comes later says nothing of the instant at which a leg was due


class _Goal(ABC):
    """The flight for a client of an action: until its end, another leg or a cancel request.

    The goal's `execute` runs only at the end, for the result: it would hold the one thread of the node.
    """

    def __init__(
        self, flight: FlightState, call: Callable[[str], Answer], goal: ServerGoalHandle
    ) -> None:
        """`call`: a service of the leader, by its name."""
        self._flight, self._call, self._goal = flight, call, goal
        self._before = flight.leg
        self._own: Leg | None = None
        self._answer = self._begin()
        self._heard_s = time.monotonic()

    @abstractmethod
    def _begin(self) -> Answer:
        """Ask the leader for what the client wants."""

    @abstractmethod
    def _follow(self, state: FleetState) -> bool:
        """Look at what the leader has accepted; whether it has ended."""

    @abstractmethod
    def _stop(self) -> Answer:
        """Ask the leader to end it."""

    @abstractmethod
    def _result(self, state: FleetState, message: str, *, success: bool) -> Any:
        """The result of the action."""

    def look(self, state: FleetState) -> bool:
        """Publish the feedback; whether the goal has ended."""
        if not self._answer.accepted:
            return self._end("abort", self._answer.message, state)
        if self._goal.is_cancel_requested:
            return self._end("canceled", f"hold: {self._stop().message}", state)
        leader = self._flight.scenario.leader.id
        if any(uav.id == leader and uav.level != UavState.STALE for uav in state.uavs):
            self._heard_s = time.monotonic()
        elif time.monotonic() > self._heard_s + _SILENT_S:
            return self._end("abort", "the leader is silent", state)
        return self._follow(state)

    def _end(self, how: str, message: str, state: FleetState) -> bool:
        result = self._result(state, message, success=how == "succeed")

        def execute(goal: ServerGoalHandle) -> Any:
            getattr(goal, how)()
            return result

        self._goal.execute(execute)
        return True


class LegGoal(_Goal):
    """A leg that is flown to its predefined time."""

    def _begin(self) -> Answer:
        return self._call(self._goal.request.leg)

    def _stop(self) -> Answer:
        return self._call("hold")

    def _result(self, state: FleetState, message: str, *, success: bool) -> Any:
        return _filled(FlyLeg.Result(success=success, message=message), state)

    def _follow(self, state: FleetState) -> bool:
        leg = self._flight.leg
        if self._own is None and leg != self._before:
            self._own = leg
        if self._own is None:
            return False
        if leg != self._own:
            name = leg.name if leg else "none"
            return self._end("abort", f"another leg has begun: {name}", state)
        feedback = FlyLeg.Feedback(share_of_time=state.share_of_time)
        self._goal.publish_feedback(_filled(feedback, state))
        time_s, late = state.leg.predefined_time_s, state.not_in_place
        if not time_s:
            return self._end("succeed", f"leg {leg.name}: it has begun", state)
        if state.share_of_time < 1.0:
            return False
        if late:
            return self._end("abort", f"not in place after {time_s:g} s: {_names(late)}", state)
        return self._end("succeed", f"in place after {time_s:g} s", state)


class MissionGoal(_Goal):
    """The legs of the mission, from one of them to the last: each is judged when it is due."""

    def _begin(self) -> Answer:
        self._outcomes: list[LegOutcome] = []
        self._words = len(self._flight.epochs.scenario.words)
        first, mission = self._goal.request.from_leg, self._flight.scenario.mission
        if mission is None:
            return Answer(False, "the scenario has no mission: expected one with mission.legs")
        if first > len(mission.legs):
            return Answer(False, f"from_leg {first}: expected 0 to {len(mission.legs)}")
        self._last = len(mission.legs)
        if first > 1:
            return self._call(leg_service(first))
        if self._flight.epochs.announced:
            later = f"expected from_leg from 2 to {self._last}"
            return Answer(False, f"the flight has begun: {later}, or a fleet with --wait")
        return self._call("start")

    def _stop(self) -> Answer:
        """As `ptnsbc mission cancel`; before the first epoch only a hold can be said."""
        answer = self._call(CANCEL_SERVICE)
        return answer if answer.accepted else self._call("hold")

    def _result(self, state: FleetState, message: str, *, success: bool) -> Any:
        return FlyMission.Result(success=success, message=message, legs=self._outcomes)

    def _follow(self, state: FleetState) -> bool:
        leg, own = self._flight.leg, self._goal.request.from_leg > 1
        flown = self._flight.epochs.scenario
        if leg is None or (own and len(flown.words) == self._words):
            return False
        self._own = self._own or leg
        now_s = seconds(self._flight.stamp_ns - leg.first_t0_ns)
        from_s = flown.words[self._words].at_s if own else 0.0
        legs = [one for one in flown.legs if one.begin_s >= from_s]
        begun = [one for one in legs if one.begin_s <= now_s]
        if not begun:
            return False
        landing = isinstance(begun[-1].leg, LandLeg) and leg.name == "land"
        if leg != self._own and not landing:
            return self._end("abort", f"another leg has begun: {leg.name}", state)
        for index, one in enumerate(begun[len(self._outcomes) :], len(self._outcomes)):
            following = begun[index + 1].begin_s if index + 1 < len(begun) else math.inf
            if following < one.due_s - 1e-9 or now_s >= one.due_s:
                self._outcomes.append(_outcome(one, following, now_s, state))
        present = begun[-1]
        if present.number == CANCEL:
            return self._end("abort", "the mission was cancelled", state)
        share = (now_s - present.begin_s) / (present.due_s - present.begin_s)
        feedback = FlyMission.Feedback(leg=present.number, name=present.name)
        feedback.share_of_time = min(max(share, 0.0), 1.0)
        self._goal.publish_feedback(_filled(feedback, state))
        if present.number != self._last or len(self._outcomes) != len(begun):
            return False
        good = (LegOutcome.IN_PLACE, LegOutcome.BEGUN)
        missed = [one for one in self._outcomes if one.outcome not in good]
        if not missed:
            return self._end("succeed", f"all {len(self._outcomes)} legs were flown", state)
        return self._end("abort", "; ".join(map(_sentence, missed)), state)


def _outcome(one: ScheduledLeg, following_s: float, now_s: float, state: FleetState) -> LegOutcome:
    """The result of a leg that another one at `following_s` cut short, or that is due."""
    found = LegOutcome(number=one.number, name=one.name, worst_error_m=math.nan)
    if following_s < one.due_s - 1e-9:
        found.outcome = LegOutcome.CUT_SHORT
    elif isinstance(one.leg, LandLeg):
        found.outcome = LegOutcome.BEGUN
    elif now_s > one.due_s + _LATE_S:
        found.outcome = LegOutcome.NOT_JUDGED
    else:
        _filled(found, state)
        found.outcome = LegOutcome.NOT_IN_PLACE if state.not_in_place else LegOutcome.IN_PLACE
    return found


def _sentence(one: LegOutcome) -> str:
    words = {
        LegOutcome.NOT_IN_PLACE: f"not in place when due: {_names(one.not_in_place)}",
        LegOutcome.CUT_SHORT: "another leg began before it was due",
        LegOutcome.NOT_JUDGED: "no state was heard when it was due",
    }
    return f"leg {one.name}: {words[one.outcome]}"


def _names(uavs: Any) -> str:
    return ", ".join(f"uav{uav}" for uav in uavs)


def _filled(message: Any, state: FleetState) -> Any:
    """A message with the worst error and the UAVs that are not in place."""
    message.worst_error_m, message.not_in_place = state.worst_error_m, state.not_in_place
    return message


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
        self.calls = FleetCalls(node, domain, fleet, signed=seal is not None)
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
        self._configs[uav] = limits.lowering(self._configs[uav])

    def _fleet_state(self) -> FleetState:
        frame, leg = self.flight.frame(), self.flight.leg
        in_formation = frame["left_s"] is not None
        reports = {one["name"]: one for one in frame["processes"]}
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
            uav = self._uav_state(one, reports.get(f"uav{one['id']}"), in_formation=in_formation)
            state.uavs.append(uav)
            if in_formation and not uav.in_place:
                state.not_in_place.append(uav.id)
        errors = (uav.formation_error_m for uav in state.uavs)
        state.worst_error_m = max(filter(math.isfinite, errors), default=math.nan)
        return state

    def _uav_state(
        self, one: Mapping[str, Any], report: Mapping[str, Any] | None, *, in_formation: bool
    ) -> UavState:
        report = report or _NOT_HEARD
        error = one["error"] if in_formation and one["error"] is not None else math.nan
        near, battery = one["near"], one["battery"]
        limits, order = self._configs[one["id"]].filter, parse_order(one["order"] or "")
        return UavState(
            id=one["id"],
            level=UavState.STALE if report["silent"] else report["level"],
            reason=report["word"],
            mode=one["mode"] or "",
            formation_error_m=error,
            in_place=not report["silent"] and error <= self._tolerance_m,
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
        response.accepted, response.message = self.calls.call(ARM_SERVICE)[:2]
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
            # In the context of this node: one of its own would have no enclave, and no way into a protected network.
            context, fleet = self._node.context, self.endpoints.fleet
            with LauncherNode(self._domain, "operator_stop", fleet, within=context) as node:
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

    def __init__(self, node: Node, domain: int, fleet: str, *, signed: bool) -> None:
        """`signed`: every call is refused, because these carry no seal."""
        self._signed = signed
        # A callback waits for these answers: another node's executor receives them.
        self._node = FleetNode(domain, "operator_calls", fleet, within=node.context)
        self._leader = LeaderClient(self._node)
        self._introduced_s = time.monotonic() + _DISCOVERY_S  # from then on all services are known

    def begin(self, name: str) -> Answer:
        """Let the leader begin a leg of `_LEGS`."""
        if name not in _LEGS and not self._signed:
            return Answer(False, f"leg {name[:40]!r}: expected one of {', '.join(_LEGS)}")
        return self.call(name)

    def call(self, name: str) -> Answer:
        """Call a service; waits for the answer, and for nothing that the network does not have."""
        if self._signed:
            return Answer(False, _SEALED)
        service = f"{self._node.endpoints.fleet}/formation/{name}"
        known = (name for name, _ in self._node.node.get_service_names_and_types())
        if time.monotonic() > self._introduced_s and service not in known:
            return not_there(name)
        return self._leader.ask(name, _ANSWER_S)

    def close(self) -> None:
        """Leave."""
        self._node.leave()
