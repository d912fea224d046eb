"""A flight of one vehicle as a state machine: from the first heartbeat to disarmed.

Pure: `advance` gets what the bridge has seen at an instant and answers what to do; time is a number.
Every step waits for its confirmation, has a time limit, and a reason when it fails. Nothing is
slept for, nothing is taken for granted because it was asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from ptnsbc_nodes.mavlink.autopilots import Autopilot, Mode

STALE_S = 0.25
"""A setpoint computed from older odometry is not followed: the vehicle is held where it is."""
STOP_S = 0.5
"""Held no longer than this: then the stream stops, and the vehicle's own failsafe acts."""
HEARTBEAT_LOST_S = 3.0

_AGAIN_S = 1.0  # a command without its confirmation is sent again
_STREAM_S = 1.5  # PX4 wants more than one second of setpoints before OFFBOARD
_RECOVERED_S = 1.0
_MODE_LAG_S = 2.5  # HEARTBEAT comes once a second
_LIFTED_M = 0.3
_ARRIVED_M = 0.5
_STILL_M_S = 0.5
_SETTLED_S = 1.0
_GROUNDED_S = 5.0
_VERDICT_S = 3.0


class Step(Enum):
    """Where in the flight the vehicle is."""

    HEARTBEAT = "waiting for a heartbeat"
    PARAMETERS = "reading parameters"
    STATE = "waiting for a valid position"
    CONTROLLER = "waiting for the UAV's controller"
    STREAM = "sending setpoints"
    MODE = "waiting for the mode"
    ARM = "arming"
    TAKEOFF = "taking off"
    AIRBORNE = "airborne, waiting for the formation"
    FLY = "in formation"
    FAILSAFE = "no setpoints: left to the vehicle's failsafe"
    YIELDED = "left to the pilot"
    LAND = "landing"
    KILL = "stopping the motors"
    DONE = "done"
    FAILED = "failed"


class Stream(Enum):
    """What the setpoint stream carries."""

    NONE = "none"
    HOLD = "hold"  # the place where holding began
    CLIMB = "climb"  # straight up to the take-off height
    PLANNER = "planner"  # what the UAV process wants


class Ask(Enum):
    """A command to the vehicle."""

    OWN_MODE = "own mode"
    ARM = "arm"
    TAKEOFF = "take off"
    LAND = "land"
    DISARM = "disarm"
    KILL = "disarm in flight"


@dataclass(frozen=True)
class Seen:
    """What the bridge knows of vehicle, controller and fleet at one instant."""

    now_s: float
    heartbeat_age_s: float = float("inf")
    stranger: str = ""  # why this is not the vehicle that was expected
    parameters: bool = False  # read
    refusal: str = ""  # why it cannot be flown with these parameters
    state: bool = False  # fresh odometry in the world frame is being told
    lack: str = ""  # what keeps it from that
    controller_age_s: float = float("inf")  # of the newest setpoint, by the odometry it rests on
    controller_ready: bool = False
    mode: Mode = Mode.OTHER
    mode_name: str = ""
    armed: bool = False
    landed: bool | None = None  # None: the vehicle does not tell
    height_m: float = 0.0  # above the place of arming
    speed_m_s: float = 0.0
    leg: str | None = None  # announced, and its epoch has come
    battery_low: str = ""
    fence: str = ""
    rebooted: bool = False
    twin: bool = False  # a second vehicle with this system id
    halt: str = ""  # "land" or "kill", from the operator, or from the end of this process
    complaint: str = ""  # newest refusal or warning of the vehicle


class Orders(NamedTuple):
    """What to do now."""

    stream: Stream
    ask: Ask | None
    told: bool
    """Whether the formation hears of this vehicle as a member; otherwise only as something near."""


_LIMITS_S: Mapping[Step, float] = {
    Step.HEARTBEAT: 120.0,
    Step.PARAMETERS: 20.0,
    Step.STATE: 120.0,
    Step.CONTROLLER: 180.0,
    Step.STREAM: 10.0,
    Step.MODE: 10.0,
    Step.ARM: 20.0,
    Step.TAKEOFF: 60.0,
    Step.LAND: 180.0,
    Step.KILL: 10.0,
}
_BEFORE_ARMING = (
    Step.HEARTBEAT,
    Step.PARAMETERS,
    Step.STATE,
    Step.CONTROLLER,
    Step.STREAM,
    Step.MODE,
    Step.ARM,
)
_SETTING_OUT = (Step.STREAM, Step.MODE, Step.ARM)
_FLYING = (Step.TAKEOFF, Step.AIRBORNE, Step.FLY)
_OVER = (Step.DONE, Step.FAILED)


class Procedure:
    """The flight of one vehicle; `advance` is called at the rate of the stream."""

    def __init__(
        self,
        autopilot: Autopilot,
        takeoff_height_m: float,
        allow_arming: bool,
        log: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._autopilot = autopilot
        self._height_m = takeoff_height_m
        self._allow_arming = allow_arming
        self._log = log
        self._since_s = float("nan")
        self._asked: dict[Ask, float] = {}
        self._good_since_s: float | None = None
        self._grounded_s: float | None = None
        self._before_failsafe = Step.AIRBORNE
        self._confirmed = False  # the mode of a landing was seen
        self._climbed = False
        self._grace_s = float("-inf")
        self.step = Step.HEARTBEAT
        self.fault = ""
        """Why the flight did not go as planned, in the order in which it went wrong."""

    @property
    def over(self) -> bool:
        """Whether there is nothing left to do."""
        return self.step in _OVER

    @property
    def ready(self) -> bool:
        """Whether the formation may begin, as far as this vehicle is concerned."""
        return self.step in (Step.AIRBORNE, Step.FLY)

    def advance(self, seen: Seen) -> Orders:
        """What to do at `seen.now_s`; changes the step as far as what was seen allows."""
        if self._since_s != self._since_s:
            self._since_s = seen.now_s
        for _ in Step:  # a step may be over before it began
            before = self.step
            self._react(seen)
            if self.step is before:
                self._HANDLERS[self.step](self, seen)
            if self.step is before:
                break
        limit = _LIMITS_S.get(self.step)
        if limit is not None and self._age(seen) > limit and self._limited(seen):
            self._expire(seen, limit)
        return self._orders(seen)

    def _limited(self, seen: Seen) -> bool:
        """Whether the step's limit counts: a pilot may take as long as it takes."""
        if self.step is Step.ARM:
            return self._allow_arming
        return not (self.step is Step.MODE and seen.armed)

    # What can happen at any time, worst first.

    def _react(self, seen: Seen) -> None:
        if self.over:
            return
        if seen.halt == "kill" and self.step is not Step.KILL and seen.armed:
            self._blame("stopped by the operator in flight", seen)
            return self._go(Step.KILL, seen)
        if seen.rebooted and self.step not in _BEFORE_ARMING:
            self._blame("the vehicle rebooted in flight", seen)
            return self._go(Step.FAILED, seen)
        if seen.twin and self.step in _BEFORE_ARMING:
            self._blame("two vehicles with this system id: give each its own", seen)
            return self._go(Step.FAILED, seen)
        if self.step in _FLYING:
            return self._react_in_flight(seen)
        grounded = (seen.battery_low or seen.fence) if self.step in _SETTING_OUT else ""
        if grounded and not seen.armed:
            self._blame(f"not armed: {grounded}", seen)
            self._go(Step.FAILED, seen)
        elif self.step in _BEFORE_ARMING and seen.halt:
            self._go(Step.LAND if seen.armed else Step.DONE, seen)
        elif self.step is Step.FAILSAFE and (seen.halt or seen.leg == "land"):
            self._go(Step.LAND, seen)

    def _react_in_flight(self, seen: Seen) -> None:
        if not seen.armed:
            if self.step is Step.TAKEOFF and seen.height_m < _LIFTED_M:
                self._blame(f"disarmed before it took off{_because(seen)}", seen)
            else:
                self._blame("disarmed in flight", seen)
            return self._go(Step.FAILED, seen)
        silent = seen.controller_age_s > STOP_S
        # After a failsafe has ended the last HEARTBEAT of it may still be on its way.
        failsafe_left = seen.mode is Mode.HOLD and seen.now_s < self._grace_s
        if seen.mode is not Mode.OWN and not silent and not failsafe_left:
            self._blame(f"the pilot took over: mode {seen.mode_name}", seen)
            return self._go(Step.YIELDED, seen)
        if seen.halt or seen.leg == "land":
            return self._go(Step.LAND, seen)
        for reason in (seen.battery_low, seen.fence):
            if reason:
                self._blame(reason, seen)
                return self._go(Step.LAND, seen)
        if silent:
            self._before_failsafe = self.step
            self._blame(f"no setpoints: {seen.lack or 'the controller is silent'}", seen)
            return self._go(Step.FAILSAFE, seen)
        return None

    # The steps.

    def _heartbeat(self, seen: Seen) -> None:
        if seen.stranger:
            self._blame(seen.stranger, seen)
            self._go(Step.FAILED, seen)
        elif seen.heartbeat_age_s < HEARTBEAT_LOST_S:
            self._go(Step.PARAMETERS, seen)

    def _parameters(self, seen: Seen) -> None:
        if seen.refusal:
            self._blame(seen.refusal, seen)
            self._go(Step.FAILED, seen)
        elif seen.parameters:
            self._go(Step.STATE, seen)

    def _state(self, seen: Seen) -> None:
        if seen.state and self._lasts(True, seen, _SETTLED_S):
            self._go(Step.CONTROLLER, seen)
        elif not seen.state:
            self._good_since_s = None

    def _controller(self, seen: Seen) -> None:
        good = seen.state and seen.controller_ready and seen.controller_age_s < STALE_S
        if not seen.state:
            self._go(Step.STATE, seen)
        elif self._lasts(good, seen, _SETTLED_S):
            self._go(Step.STREAM, seen)

    def _stream(self, seen: Seen) -> None:
        if self._lapsed(seen):
            self._go(Step.STATE, seen)
        elif self._age(seen) >= _STREAM_S or not self._autopilot.stream_first:
            self._go(Step.MODE, seen)

    def _mode(self, seen: Seen) -> None:
        if self._lapsed(seen):
            self._go(Step.STATE, seen)
        elif seen.mode is Mode.OWN:
            self._go(Step.ARM, seen)

    def _arm(self, seen: Seen) -> None:
        if self._lapsed(seen):
            self._go(Step.STATE, seen)
        elif seen.mode is not Mode.OWN:
            self._blame(f"the pilot took over before arming: mode {seen.mode_name}", seen)
            self._go(Step.FAILED, seen)
        elif seen.armed and seen.landed is False:
            self._go(Step.AIRBORNE, seen)  # a pilot flew it up and gave it to us
        elif seen.armed and self._allow_arming:
            self._climbed = True
            self._go(Step.TAKEOFF, seen)

    def _takeoff(self, seen: Seen) -> None:
        there = abs(seen.height_m - self._height_m) < _ARRIVED_M and seen.speed_m_s < _STILL_M_S
        if self._lasts(there, seen, _SETTLED_S):
            self._go(Step.AIRBORNE, seen)

    def _airborne(self, seen: Seen) -> None:
        if seen.leg in ("form", "hold"):
            self._go(Step.FLY, seen)

    def _fly(self, seen: Seen) -> None:
        """Nothing to wait for: a landing ends it, `_react_in_flight`."""

    def _failsafe(self, seen: Seen) -> None:
        if not seen.armed:
            if self._age(seen) < _VERDICT_S:
                return None  # what became of it, a reboot perhaps, is not heard in one message
            self._blame("landed by its failsafe" if seen.landed else "disarmed in flight", seen)
            return self._go(Step.FAILED, seen)
        if self._age(seen) > _MODE_LAG_S and seen.mode not in (Mode.OWN, Mode.HOLD):
            # The failsafe lands or returns, or a pilot has it: not ours any more.
            return self._go(Step.YIELDED, seen)
        good = seen.controller_age_s < STALE_S and seen.heartbeat_age_s < HEARTBEAT_LOST_S
        if self._lasts(good, seen, _RECOVERED_S):
            self._resume(seen)
        return None

    def _resume(self, seen: Seen) -> None:
        """Send setpoints again: PX4 then returns to OFFBOARD by itself, unless a pilot took it.

        The mode is never asked for: who switched to Hold in the meantime keeps the vehicle.
        """
        if seen.mode is Mode.OWN:
            self._log("setpoints are back, the formation goes on")
            self._grace_s = seen.now_s + _MODE_LAG_S
            self._go(self._before_failsafe, seen)
        elif self._age(seen) > _RECOVERED_S + 2 * _MODE_LAG_S and self._good_for(seen) > (
            _RECOVERED_S + _MODE_LAG_S
        ):
            self._go(Step.YIELDED, seen)

    def _yielded(self, seen: Seen) -> None:
        if not seen.armed:
            self._go(Step.FAILED, seen)

    def _land(self, seen: Seen) -> None:
        if not seen.armed:
            return self._go(Step.DONE, seen)
        self._confirmed = self._confirmed or seen.mode is Mode.LAND
        if seen.mode not in (Mode.LAND, Mode.OWN) and self._taken(seen):
            self._blame(f"the pilot took over while landing: mode {seen.mode_name}", seen)
            return self._go(Step.YIELDED, seen)
        if not seen.landed:
            self._grounded_s = None
        elif self._grounded_s is None:
            self._grounded_s = seen.now_s
        return None

    def _taken(self, seen: Seen) -> bool:
        """Whether a mode that is not ours can only be somebody's wish."""
        return self._confirmed or self._age(seen) > 2 * _MODE_LAG_S

    def _kill(self, seen: Seen) -> None:
        if not seen.armed:
            self._go(Step.FAILED, seen)

    def _nothing(self, seen: Seen) -> None:
        pass

    _HANDLERS: Mapping[Step, Callable[[Procedure, Seen], None]] = {
        Step.HEARTBEAT: _heartbeat,
        Step.PARAMETERS: _parameters,
        Step.STATE: _state,
        Step.CONTROLLER: _controller,
        Step.STREAM: _stream,
        Step.MODE: _mode,
        Step.ARM: _arm,
        Step.TAKEOFF: _takeoff,
        Step.AIRBORNE: _airborne,
        Step.FLY: _fly,
        Step.FAILSAFE: _failsafe,
        Step.YIELDED: _yielded,
        Step.LAND: _land,
        Step.KILL: _kill,
        Step.DONE: _nothing,
        Step.FAILED: _nothing,
    }

    # What follows from the step.

    def _orders(self, seen: Seen) -> Orders:
        stream, ask = self._wanted(seen)
        return Orders(stream, self._due(ask, seen), self._told(seen))

    def _wanted(self, seen: Seen) -> tuple[Stream, Ask | None]:
        autopilot, step = self._autopilot, self.step
        early = Stream.HOLD if autopilot.stream_first else Stream.NONE
        if step is Step.STREAM:
            return early, None
        if step is Step.MODE:
            # Who is armed already is flown by somebody: the mode is theirs to give.
            return early, None if seen.armed else Ask.OWN_MODE
        if step is Step.ARM:
            return early, Ask.ARM if self._allow_arming and not seen.armed else None
        if step is Step.TAKEOFF:
            if autopilot.climbs:
                return Stream.CLIMB, None
            return Stream.NONE, Ask.TAKEOFF if seen.height_m < _LIFTED_M else None
        if step is Step.AIRBORNE:
            return (Stream.CLIMB if self._climbed else Stream.HOLD), None
        if step is Step.FLY:
            fresh = seen.controller_age_s <= STALE_S
            return Stream.PLANNER if fresh else Stream.HOLD, None
        if step is Step.LAND:
            return self._landing(seen)
        if step is Step.FAILSAFE:
            return (Stream.HOLD if self._good_for(seen) > _RECOVERED_S else Stream.NONE), None
        return Stream.NONE, Ask.KILL if step is Step.KILL else None

    def _landing(self, seen: Seen) -> tuple[Stream, Ask | None]:
        if self._grounded_s is not None and seen.now_s - self._grounded_s > _GROUNDED_S:
            return Stream.NONE, Ask.DISARM
        if seen.mode is Mode.LAND:
            return Stream.NONE, None
        # Until the vehicle has taken over it still needs setpoints, if it has any.
        fresh = seen.controller_age_s <= STOP_S and seen.mode is Mode.OWN
        return (Stream.HOLD if fresh else Stream.NONE), Ask.LAND

    def _told(self, seen: Seen) -> bool:
        if self.step in (Step.YIELDED, Step.KILL, *_OVER):
            return False
        return self.step is not Step.LAND or seen.leg == "land"

    def _due(self, ask: Ask | None, seen: Seen) -> Ask | None:
        """The command, when it is time to send it (again)."""
        if ask is None:
            return None
        last = self._asked.get(ask)
        if last is not None and seen.now_s - last < _AGAIN_S:
            return None
        self._asked[ask] = seen.now_s
        return ask

    # Bookkeeping.

    def _go(self, step: Step, seen: Seen) -> None:
        self._log(f"{step.value}{f': {self.fault}' if step is Step.FAILED else ''}")
        self.step = step
        self._since_s = seen.now_s
        self._good_since_s = self._grounded_s = None
        self._confirmed = False
        self._asked.clear()

    def _age(self, seen: Seen) -> float:
        return seen.now_s - self._since_s

    def _lapsed(self, seen: Seen) -> bool:
        """Before arming: whether position or controller went away again."""
        return not seen.state or seen.controller_age_s > STOP_S

    def _lasts(self, good: bool, seen: Seen, seconds: float) -> bool:
        """Whether something has been good for so long without a break."""
        if not good:
            self._good_since_s = None
            return False
        if self._good_since_s is None:
            self._good_since_s = seen.now_s
        return seen.now_s - self._good_since_s >= seconds

    def _good_for(self, seen: Seen) -> float:
        return 0.0 if self._good_since_s is None else seen.now_s - self._good_since_s

    def _blame(self, reason: str, seen: Seen) -> None:
        if reason not in self.fault:
            self.fault = "; ".join(filter(None, (self.fault, reason)))
        self._log(reason)

    def _expire(self, seen: Seen, limit: float) -> None:
        waited = {
            Step.STATE: seen.lack,
            Step.CONTROLLER: seen.lack or "no fresh setpoints from a controller that is ready",
            Step.MODE: f"{self._autopilot.own_mode} not confirmed",
            Step.ARM: "arming refused",
            Step.TAKEOFF: f"at {seen.height_m:.1f} m of {self._height_m:g} m",
        }.get(self.step, "")
        detail = f": {waited}" if waited else ""
        self._blame(f"{self.step.value}: not within {limit:g} s{detail}{_because(seen)}", seen)
        self._go(Step.LAND if self.step is Step.TAKEOFF else Step.FAILED, seen)


def _because(seen: Seen) -> str:
    return f" ({seen.complaint})" if seen.complaint else ""
