"""Goals of the operator's actions: a leg or a mission that is followed for a client, to its result."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from ptnsbc_interfaces.action import FlyLeg, FlyMission
from ptnsbc_interfaces.msg import FleetState, LegOutcome, UavState
from rclpy.action.server import ServerGoalHandle

from ptnsbc_nodes.comm.legs import Leg
from ptnsbc_nodes.fleet.fleet_node import Answer
from ptnsbc_nodes.uav.leg_services import CANCEL_SERVICE, leg_service
from ptnsbc_nodes.view.flight_state import FlightState
from ptnsbc_sim.scenario.mission.legs import CANCEL, LandLeg, ScheduledLeg

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
        now_s = (self._flight.stamp_ns - leg.first_t0_ns) * 1e-9
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
    said = {
        LegOutcome.NOT_IN_PLACE: f"not in place when due: {_names(one.not_in_place)}",
        LegOutcome.CUT_SHORT: "another leg began before it was due",
        LegOutcome.NOT_JUDGED: "no state was heard when it was due",
    }
    return f"leg {one.name}: {said[one.outcome]}"


def _names(uavs: Any) -> str:
    return ", ".join(f"uav{uav}" for uav in uavs)


def _filled(message: Any, state: FleetState) -> Any:
    """A message with the worst error and the UAVs that are not in place."""
    message.worst_error_m, message.not_in_place = state.worst_error_m, state.not_in_place
    return message
