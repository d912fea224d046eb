"""What makes one autopilot different from another: the part of a vehicle that `px4` and the others write."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_sim.autopilot.commands import COMMANDS, Request, Run
from ptnsbc_sim.autopilot.parameters import AutopilotParameters
from ptnsbc_sim.autopilot.physics.airframe import LoopGains
from ptnsbc_sim.autopilot.physics.geodesy import PX4_RADIUS_M


class HeartbeatFields(NamedTuple):
    """The fields of HEARTBEAT that change."""

    base_mode: int
    custom_mode: int
    system_status: int


class Firmware(ABC):
    """Constants and rules of one kind of autopilot."""

    mav_type: ClassVar[int] = mavlink.MAV_TYPE_QUADROTOR
    autopilot: ClassVar[int]
    capabilities: ClassVar[int]
    version_word: ClassVar[int]
    earth_radius_m: ClassVar[float] = PX4_RADIUS_M  # of its projection
    text_end: ClassVar[str] = ""
    refusal: ClassVar[int]  # MAV_RESULT of an arming request that is refused
    rates_hz: ClassVar[tuple[Mapping[int, float], Mapping[int, float]]]  # per link
    ready_s: ClassVar[tuple[float, float]]  # from boot to a valid position, at least and at most
    dead_reckoning_s: ClassVar[float] = 5.0
    commands: ClassVar[Mapping[int, Run]] = COMMANDS

    @abstractmethod
    def default_parameters(self) -> AutopilotParameters:
        """Parameters after a factory reset."""

    @abstractmethod
    def gains(self) -> LoopGains:
        """Gains and limits of the loops, from the parameters."""

    @property
    @abstractmethod
    def mode_name(self) -> str:
        """Name of the mode that is flown."""

    @abstractmethod
    def status(self) -> HeartbeatFields:
        """Mode and state for HEARTBEAT."""

    @abstractmethod
    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""

    @abstractmethod
    def arming_problem(self, t: float) -> str | None:
        """Why it would not arm now."""

    @abstractmethod
    def on_boot(self, t: float) -> None:
        """Mode and memory after a boot."""

    @abstractmethod
    def on_armed(self, t: float) -> None:
        """The motors have been switched on."""

    @abstractmethod
    def on_disarmed(self, t: float) -> None:
        """The motors have been switched off."""

    @abstractmethod
    def set_mode(self, request: Request, t: float) -> int:
        """DO_SET_MODE; MAV_RESULT."""

    @abstractmethod
    def take_off(self, request: Request, t: float) -> int:
        """NAV_TAKEOFF; MAV_RESULT."""

    @abstractmethod
    def land(self, t: float) -> int:
        """NAV_LAND; MAV_RESULT."""

    @abstractmethod
    def return_home(self, t: float) -> int:
        """NAV_RETURN_TO_LAUNCH; MAV_RESULT."""

    @abstractmethod
    def pilot(self, mode: str, t: float) -> bool:
        """A pilot with a transmitter chooses a mode by name; False when there is none of that name."""

    @abstractmethod
    def on_trajectory(self, message: Any, t: float) -> None:
        """SET_POSITION_TARGET_LOCAL_NED."""

    @abstractmethod
    def on_attitude(self, message: Any, t: float) -> None:
        """SET_ATTITUDE_TARGET."""

    @abstractmethod
    def watch(self, t: float) -> None:
        """Rules that act by themselves: failsafes, disarming."""

    @abstractmethod
    def aim(self, t: float) -> Array:
        """What the airframe follows until the next step (22,)."""

    def refusal_text(self, problem: str) -> str:
        """What it says when it does not arm."""
        return f"Arm: {problem}"
