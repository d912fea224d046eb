"""The words a flight is told in: its steps, what is seen, what is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from ptnsbc_io.mavlink.autopilots import Autopilot, FlightMode

STALE_S = 0.25
"""A setpoint computed from older odometry is not followed: the vehicle is held where it is."""
STOP_S = 0.5
"""Held no longer than this: then the stream stops, and the vehicle's own failsafe acts."""
HEARTBEAT_LOST_S = 3.0
RECOVERED_S = 1.0  # setpoints fresh for so long are back
LIFTED_M = 0.3


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


class CommandRequest(Enum):
    """A command to the vehicle."""

    OWN_MODE = "own mode"
    ARM = "arm"
    TAKEOFF = "take off"
    LAND = "land"
    DISARM = "disarm"
    KILL = "disarm in flight"


@dataclass(frozen=True)
class VehicleSnapshot:
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
    mode: FlightMode = FlightMode.OTHER
    mode_name: str = ""
    armed: bool = False
    landed: bool | None = None  # None: the vehicle does not tell
    height_m: float = 0.0  # above the place of arming
    speed_m_s: float = 0.0
    turned: bool = True  # has the heading with which the formation begins
    leg: str | None = None  # announced, and its epoch has come
    battery_low: str = ""
    fence: str = ""
    rebooted: bool = False
    twin: bool = False  # a second vehicle with this system id
    halt: str = ""  # "land" or "kill", from the operator, or from the end of this process
    complaint: str = ""  # newest refusal or warning of the vehicle


class ProcedureOptions(NamedTuple):
    """What is settled before the flight."""

    autopilot: Autopilot
    takeoff_height_m: float
    allow_arming: bool


class ProcedureOutput(NamedTuple):
    """What to do now."""

    stream: Stream
    ask: CommandRequest | None
    told: bool
    """Whether the formation hears of this vehicle as a member; otherwise only as something near."""


BEFORE_ARMING = (
    Step.HEARTBEAT,
    Step.PARAMETERS,
    Step.STATE,
    Step.CONTROLLER,
    Step.STREAM,
    Step.MODE,
    Step.ARM,
)
SETTING_OUT = (Step.STREAM, Step.MODE, Step.ARM)
FLYING = (Step.TAKEOFF, Step.AIRBORNE, Step.FLY)
OVER = (Step.DONE, Step.FAILED)


def because(seen: VehicleSnapshot) -> str:
    """What the vehicle says about it, in brackets; empty when it says nothing."""
    return f" ({seen.complaint})" if seen.complaint else ""
