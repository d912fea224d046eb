"""State of one stand-in: power, arming, parameters, outgoing messages, and the rules that each firmware fills in.

It has neither sockets nor a clock: every call gets the time, in seconds of any steady clock, so tests run faster
than real time. `controller` moves it through time and passes messages to it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from ptnsbc_autopilot.parameters import AutopilotParameters
from ptnsbc_autopilot.physics.airframe import LoopGains
from ptnsbc_autopilot.physics.body import VehicleDescription, VehiclePhysics
from ptnsbc_autopilot.physics.frames import PX4_RADIUS_M
from ptnsbc_autopilot.timing import BootClock, MessageStreams
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink

COMPANION, GCS, IMPOSTOR = 0, 1, 2
"""Links of a vehicle, by number; the last one is for a second sender with the same system id."""

GCS_TIMEOUT_S = 2.5
SILENT_AT_BOOT_S = 2.0
_LANDED_AFTER_S = 1.0  # time on the ground until landed
_TEXT_CHUNK = 50  # [bytes] of STATUSTEXT

Log = Callable[[str], None]


class AutopilotError(PtnsbcError):
    """A stand-in cannot be started, or a fault cannot be injected, as requested."""


class Outgoing(NamedTuple):
    """One message for one link."""

    link: int
    message: Any


class Request(NamedTuple):
    """A command, from whichever message it came."""

    command: int
    params: tuple[float, ...]  # (7,)
    system: int  # of the sender
    component: int


class HeartbeatFields(NamedTuple):
    """The fields of HEARTBEAT that change."""

    base_mode: int
    custom_mode: int
    system_status: int


@dataclass
class Faults:
    """Faults that last until they are taken back."""

    no_heartbeat: bool = False
    mute: bool = False  # neither sends nor answers, and flies on
    refuse_arming: bool = False
    deny_arming: bool = False  # though all its checks pass
    takeoff_detected: bool = False  # armed on the ground, it takes itself for flying
    unhealthy: int = 0  # bits of MAV_SYS_STATUS_SENSOR
    duplicate: bool = False  # a second sender uses the same system id


class Firmware(ABC):
    """The constants and rules that each firmware fills in."""

    mav_type: ClassVar[int] = mavlink.MAV_TYPE_QUADROTOR
    autopilot: ClassVar[int]
    capabilities: ClassVar[int]
    version_word: ClassVar[int]
    earth_radius_m: ClassVar[float] = PX4_RADIUS_M  # of its projection
    drag_1_s: ClassVar[float] = 0.0  # specific drag of the vehicle that was measured
    text_end: ClassVar[str] = ""
    text_to_companions: ClassVar[bool] = True  # also to links without a ground station
    refusal_text: ClassVar[str] = "Arm"
    refusal: ClassVar[int]  # MAV_RESULT of a refused arming request
    rates_hz: ClassVar[tuple[Mapping[int, float], Mapping[int, float]]]  # per link
    ready_s: ClassVar[tuple[float, float]]  # from boot to a valid position, at least and at most
    dead_reckoning_s: ClassVar[float] = 5.0
    has_logs: ClassVar[bool] = True
    first_log: ClassVar[int] = 0  # the number of the first one
    command_ids: ClassVar[frozenset[int] | None] = None  # the commands it knows; None: all

    @abstractmethod
    def default_parameters(self) -> AutopilotParameters:
        """Parameters after a factory reset."""

    @abstractmethod
    def gains(self) -> LoopGains:
        """Gains and limits of the control loops, from the parameters."""

    @property
    @abstractmethod
    def mode_name(self) -> str:
        """Name of the active flight mode."""

    @abstractmethod
    def heartbeat_fields(self, t: float) -> HeartbeatFields:
        """Mode and state for HEARTBEAT."""

    @abstractmethod
    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""

    @abstractmethod
    def arming_problem(self, t: float) -> str | None:
        """The first failed arming check; None when it would arm."""

    @abstractmethod
    def on_boot(self, t: float) -> None:
        """Set mode and memory after a boot."""

    @abstractmethod
    def on_armed(self, t: float) -> None:
        """The motors have been switched on."""

    @abstractmethod
    def on_disarmed(self, t: float) -> None:
        """The motors have been switched off."""

    @abstractmethod
    def fly(self, request: Request, t: float) -> int:
        """DO_SET_MODE, NAV_TAKEOFF, NAV_LAND or NAV_RETURN_TO_LAUNCH; MAV_RESULT."""

    @abstractmethod
    def set_mode_by_rc(self, mode: str, t: float) -> bool:
        """A pilot's transmitter selects a mode by name; False when there is none of that name."""

    @abstractmethod
    def on_setpoint(self, message: Any, t: float) -> None:
        """SET_POSITION_TARGET_LOCAL_NED or SET_ATTITUDE_TARGET."""

    @abstractmethod
    def update_mode(self, t: float) -> None:
        """Rules that act without a command: failsafes, disarming."""

    @abstractmethod
    def airframe_target(self, t: float) -> Array:
        """The target (22,) of the airframe until the next step."""


class StandInVehicle(Firmware):
    """One flight controller and the vehicle under it."""

    def __init__(
        self,
        system: int,
        body: VehicleDescription,
        t: float,
        *,
        boot_time: float = 1.0,
        say: Log = lambda _line: None,
    ) -> None:
        """Args:
        system: MAVLink system id.
        body: the physical vehicle.
        t: time of boot [s].
        boot_time: scales the time until the position is valid.
        say: gets a line for each event.
        """
        self.system = system
        self.component = 1
        self.body = body.with_drag(self.drag_1_s)
        self.log = say
        self.parameters = self.default_parameters()
        self.flight = VehiclePhysics(self.body, self.gains(), t)
        self.clock = BootClock(t)
        self.faults = Faults()
        self.boots = 0
        self.flown = 0  # times that it was armed: each has a log
        self.armed = False
        self.armed_t = t
        self.lifted = False  # has left the ground since it was armed
        self.home_local_enu: Array = self.flight.estimate.position_enu.copy()
        self.gcs_heard: dict[int, float] = {}  # time of the last ground station's HEARTBEAT by link
        self.outgoing: list[Outgoing] = []
        self.slow_queue: deque[Outgoing] = deque()  # one message per step
        self._boot_time = boot_time
        self._text_id = 0
        self._boot(t)

    @property
    def in_contact(self) -> bool:
        """True if it touches the ground."""
        return self.flight.in_contact

    @property
    def landed(self) -> bool:
        """True if the land detector is sure."""
        return self.flight.standing_s >= _LANDED_AFTER_S or not (self.armed or not self.in_contact)

    def booting(self, t: float) -> bool:
        """True if it is still silent after a reboot."""
        return t < self._silent_until

    def position_valid(self, t: float) -> bool:
        """True if the estimator has a valid position."""
        lost_s = self.flight.navigation.lost_s(t)
        return t >= self._ready_at and lost_s < self.dead_reckoning_s

    def gcs_on(self, link: int, t: float) -> bool:
        """True if a ground station sent HEARTBEAT on a link lately; a companion does not count."""
        return t - self.gcs_heard.get(link, -math.inf) < GCS_TIMEOUT_S

    # Power and arming.

    def _boot(self, t: float) -> None:
        """Set what every boot sets, the first one too."""
        self._silent_until = t + SILENT_AT_BOOT_S if self.boots else t
        self.reboot_at = math.inf
        least, most = self.ready_s
        spread = (self.flight.body.seed * 0.6180339887) % 1.0
        self._ready_at = self._silent_until + (least + spread * (most - least)) * self._boot_time
        self.clock.reboot(self._silent_until)
        self.streams = [MessageStreams(rates, self._silent_until) for rates in self.rates_hz]
        self.slow_queue.clear()
        self.gcs_heard.clear()
        self.armed = self.lifted = False
        self.home_local_enu = self.flight.estimate.position_enu.copy()
        self.on_boot(t)

    def reboot(self, t: float) -> None:
        """Restart the autopilot, in the air too: the motors stop."""
        self.boots += 1
        self.flight.reboot()
        self.flight.advance(t)
        self._boot(t)
        self.log("rebooted")

    def arm(self, t: float) -> None:
        """Switch the motors on, without checks."""
        self.armed, self.armed_t, self.lifted = True, t, False
        self.flown += 1
        self.home_local_enu = self.flight.estimate.position_enu.copy()
        self.on_armed(t)
        self.log("armed")

    def disarm(self, reason: str, t: float) -> None:
        """Switch the motors off, in the air too."""
        self.armed = self.lifted = False
        self.on_disarmed(t)
        self.log(f"disarmed: {reason}")

    def set_parameter(self, name: str, value: float) -> None:
        """Change a parameter and what follows from it.

        Raises:
            AutopilotError: there is none of that name.
        """
        if name not in self.parameters:
            raise AutopilotError(f"param {name}: expected one of {', '.join(self.parameters)}")
        self.parameters.put(name, value)
        self.flight.gains = self.gains()
        self.log(f"{name} = {value:g}")

    # Sending.

    def send(self, link: int, message: Any) -> None:
        """Put a message on a link."""
        self.outgoing.append(Outgoing(link, message))

    def send_slowly(self, link: int, messages: Iterable[Any]) -> None:
        """Put messages on a link, one per step."""
        self.slow_queue.extend(Outgoing(link, message) for message in messages)

    def text_links(self, t: float) -> list[int]:
        """Links that get STATUSTEXT."""
        every = range(len(self.rates_hz))
        return [link for link in every if self.text_to_companions or self.gcs_on(link, t)]

    def send_text(self, text: str, t: float, severity: int = mavlink.MAV_SEVERITY_CRITICAL) -> None:
        """Send STATUSTEXT in chunks of 50 bytes, and log the text."""
        self.log(text)
        data = (text + self.text_end).encode()
        chunks = [data[i : i + _TEXT_CHUNK] for i in range(0, len(data), _TEXT_CHUNK)]
        self._text_id = self._text_id % 65535 + 1
        number = self._text_id if len(chunks) > 1 else 0
        for link in self.text_links(t):
            for index, chunk in enumerate(chunks):
                self.send(link, mavlink.MAVLink_statustext_message(severity, chunk, number, index))
