"""The vocabulary of a flight: its steps, the snapshot of the vehicle, and the output of the procedure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from ptnsbc_io.mavlink.flight_mode import FlightMode

STALE_S = 0.25
"""A setpoint computed from older odometry is not followed: the vehicle is held where it is."""
STOP_S = 0.5
"""The vehicle is held no longer than this. Then the stream stops, and the vehicle's own failsafe acts."""
AWAY_S = 30.0
"""The time for which a vehicle is held without its controller where UAVs come and go; then it is told to land."""
HEARTBEAT_LOST_S = 3.0
SILENT_S = 10.0
"""A vehicle that must land but has sent nothing for this long is given up: its bridge ends and says so."""
SILENT_KILL_S = 30.0
"""The same for a vehicle whose motors must stop: the order is sent for longer."""
RECOVERED_S = 1.0
"""Setpoints count as recovered once they have been fresh for this long."""
LIFTED_M = 0.3


class Step(Enum):
    """The step of the flight in which the vehicle is."""

    HEARTBEAT = "waiting for a heartbeat"
    PARAMETERS = "reading parameters"
    STATE = "waiting for a valid position"
    CONTROLLER = "waiting for the UAV's controller"
    STREAM = "sending setpoints"
    MODE = "waiting for the mode"
    CHECKS = "waiting for its pre-arm checks"
    READY = "ready to arm, waiting for the others"
    ARM = "arming"
    ARMED = "armed, waiting for the others"
    DISARM = "disarming on the ground"
    TAKEOFF = "taking off"
    AIRBORNE = "airborne, waiting for the formation"
    FLY = "in formation"
    HELD = "held: its controller is away"
    APART = "holding apart by height"
    FAILSAFE = "no setpoints: left to the vehicle's failsafe"
    RETURN = "returning by its own mode"
    YIELDED = "left to the pilot"
    LAND = "landing"
    KILL = "stopping the motors"
    DONE = "done"
    FAILED = "failed"


SETTING_OUT = (Step.STREAM, Step.MODE, Step.CHECKS, Step.READY, Step.ARM)
BEFORE_ARMING = (Step.HEARTBEAT, Step.PARAMETERS, Step.STATE, Step.CONTROLLER, *SETTING_OUT)
FLYING = (Step.TAKEOFF, Step.AIRBORNE, Step.FLY, Step.HELD)
OVER = (Step.DONE, Step.FAILED)


class Stream(Enum):
    """The content of the setpoint stream."""

    NONE = "none"
    HOLD = "hold"  # the position at which holding began
    CLIMB = "climb"  # straight up to the take-off height
    APART = "apart"  # the position at which it began, at the height of this vehicle's layer
    PLANNER = "planner"  # the setpoints of the UAV process


class CommandRequest(Enum):
    """A command to the vehicle."""

    OWN_MODE = "own mode"
    CHECK = "check"
    ARM = "arm"
    TAKEOFF = "take off"
    LAND = "land"
    RETURN = "return"
    DISARM = "disarm"
    KILL = "disarm in flight"


@dataclass(frozen=True)
class VehicleSnapshot:
    """Vehicle, controller and fleet as the bridge sees them at one instant."""

    now_s: float
    heartbeat_age_s: float = float("inf")
    wrong_vehicle: str = ""  # why this is not the expected vehicle
    parameters_read: bool = False
    parameter_refusal: str = ""  # why the vehicle cannot be flown with its parameters
    state_fault: str = ""  # why no fresh odometry in the world frame is published; empty when it is
    controller_age_s: float = float("inf")  # age of the odometry that the newest setpoint answers
    controller_ready: bool = False
    controller_absent: bool = False
    """True while its process is not heard: its launcher starts it when vehicles may arm."""
    mode: FlightMode = FlightMode.OTHER
    mode_name: str = ""
    armed: bool = False
    landed: bool | None = None  # None: the vehicle does not report it
    height_m: float = 0.0  # above the place of arming
    speed_m_s: float = 0.0
    unprepared: str = ""  # what the formation waits for once the vehicle is airborne
    leg: str | None = None  # the announced leg whose epoch has come
    leaves: bool = False  # its leg is the landing of this vehicle alone: the others fly on
    battery_low: str = ""
    fence_breach: str = ""
    hazard: str = ""  # why the formation must be given up, seen on board or told by another bridge
    apart: bool = False  # whether the vehicle is at the height of its layer
    below: str = ""  # the vehicle in the air below, in the way of a landing
    rebooted: bool = False
    duplicate_sysid: bool = False  # a second vehicle uses this system id
    stop_request: str = ""  # "land" or "kill", by the operator or at the end of this process
    told_home: bool = False  # by the operator: it returns by its autopilot's own mode
    pilots_too: bool = False  # whether the request counts in a pilot's hands as well
    unfit: str = ""  # why the scenario's gains would swing the vehicle
    unready: str = ""  # why the vehicle would refuse to arm
    misplaced: str = ""  # why the vehicle may not arm where it stands
    not_ready: str = ""  # other vehicles that are not ready to arm
    not_armed: str = ""  # other vehicles that are not armed
    climbs_first: str = ""  # other vehicles that climb before this one
    strayed: str = ""  # how far it is off the place over which it climbed
    companion_out: str = ""  # another vehicle that will not fly, and why
    vehicle_warning: str = ""  # newest refusal or warning of the vehicle
    left_behind: str = "armed"  # and its place, mode, and what it does without its bridge

    @property
    def lands(self) -> bool:
        """True if its leg is a landing; one that leaves the others does not land onto a vehicle below."""
        return self.leg == "land" and not (self.leaves and self.below)

    @property
    def vehicle_reason(self) -> str:
        """The vehicle's own reason in brackets; empty when it gives none."""
        return f" ({self.vehicle_warning})" if self.vehicle_warning else ""


class Lasting:
    """The time for which a condition has been true without a break."""

    def __init__(self) -> None:
        self._since_s: float | None = None

    def update(self, holds: bool, now_s: float) -> float:
        """The time at `now_s`; negative while the condition is false."""
        if not holds:
            self._since_s = None
            return -1.0
        self._since_s = now_s if self._since_s is None else self._since_s
        return now_s - self._since_s

    def seconds(self, now_s: float) -> float:
        """The time at `now_s` if the condition is still as it was; zero while it is false."""
        return 0.0 if self._since_s is None else now_s - self._since_s


class ProcedureOutput(NamedTuple):
    """The actions of one instant."""

    stream: Stream
    command: CommandRequest | None
    in_formation: bool
    """True if the formation follows this vehicle's odometry; otherwise the others only avoid it."""


Position = tuple[float, float, float]


class Companion(NamedTuple):
    """The report of the bridge of another vehicle."""

    step: str
    fault: str
    position: Position | None  # in the world [m]
    error_m: float  # of that position, horizontally
    height_m: float  # above the place of arming
