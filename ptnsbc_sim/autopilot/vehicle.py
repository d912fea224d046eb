"""What all stand-ins do alike, as an object without sockets and without a clock of its own.

`step(t)` moves it to a time and returns what it sends; `handle(message, link, t)` returns the answers. Times are
seconds of any steady clock, so tests run faster than real time. Personalities say what a mode, an arming request
and a setpoint mean: `px4`, `arducopter`, `stm32`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_sim.autopilot.clock import BootClock
from ptnsbc_sim.autopilot.codec import AutopilotError
from ptnsbc_sim.autopilot.faults import IMPOSTOR_PERIOD_S, Faults, impostor
from ptnsbc_sim.autopilot.firmware.firmware import Firmware
from ptnsbc_sim.autopilot.message_handlers import ANSWERS, UNADDRESSED
from ptnsbc_sim.autopilot.physics.body import VehicleDescription, VehiclePhysics
from ptnsbc_sim.autopilot.streams import Streams
from ptnsbc_sim.autopilot.telemetry import BUILDERS

COMPANION, GCS, IMPOSTOR = 0, 1, 2
"""Links of a vehicle, by number; on the last somebody else uses its system id."""

GCS_TIMEOUT_S = 2.5
DARK_AT_BOOT_S = 2.0
_STANDING_S = 1.0  # on the ground for so long counts as landed
_SLOW_PER_STEP = 1
_CHUNK = 50

Say = Callable[[str], None]


class Outgoing(NamedTuple):
    """One message for one link."""

    link: int
    message: Any


def _nothing(_line: str) -> None:
    pass


class StandInVehicle(Firmware):
    """One flight controller and the vehicle under it."""

    def __init__(
        self,
        system: int,
        body: VehicleDescription,
        t: float,
        *,
        boot_time: float = 1.0,
        say: Say = _nothing,
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
        self.body = body
        self.parameters = self.default_parameters()
        self.flight = VehiclePhysics(body, self.gains(), t)
        self.clock = BootClock(t)
        self.faults = Faults()
        self.boots = 0
        self.armed = False
        self.armed_t = t
        self.lifted = False  # has flown since it was armed
        self.home_local_enu: Array = self.flight.position_enu.copy()
        self._boot_time = boot_time
        self._log = say
        self._out: list[Outgoing] = []
        self._queue: deque[Outgoing] = deque()
        self.gcs_heard: dict[int, float] = {}
        self._text_id = 0
        self._impostor_t = -math.inf
        self._start(t)

    # The two calls.

    def step(self, t: float) -> list[Outgoing]:
        """Move to t [s]; what is sent unasked."""
        self.flight.advance(t)
        if t >= self._reboot_at:
            self.reboot(t)
        if self.booting(t):
            return []
        if not self.in_contact:
            self.lifted = self.armed
        self.watch(t)
        self.flight.target = self.aim(t)
        for link, streams in enumerate(self._streams):
            for message_id in streams.due(t):
                self._send_id(message_id, link, t)
        for _ in range(min(_SLOW_PER_STEP, len(self._queue))):
            self._out.append(self._queue.popleft())
        if self.faults.duplicate and t >= self._impostor_t:
            self._impostor_t = t + IMPOSTOR_PERIOD_S
            self._out += [Outgoing(IMPOSTOR, message) for message in impostor(self, t)]
        return self._taken()

    def handle(self, message: Any, link: int, t: float) -> list[Outgoing]:
        """Take one message; the answers. Messages for others are ignored."""
        answer = ANSWERS.get(message.get_type())
        if answer is None or self.booting(t) or self.faults.mute or not self._for_us(message):
            return []
        answer(self, message, link, t)
        return self._taken()

    def _taken(self) -> list[Outgoing]:
        out, self._out = self._out, []
        return [] if self.faults.mute else out

    def _for_us(self, message: Any) -> bool:
        if message.get_type() in UNADDRESSED:
            return True
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.system) and component in (0, self.component)

    # State that all have.

    @property
    def in_contact(self) -> bool:
        """Whether it touches the ground."""
        return self.flight.in_contact

    @property
    def landed(self) -> bool:
        """Whether the land detector is sure."""
        return self.flight.standing_s >= _STANDING_S or not (self.armed or not self.in_contact)

    def booting(self, t: float) -> bool:
        """Whether it is still dark after a reboot."""
        return t < self._dark_until

    def position_valid(self, t: float) -> bool:
        """Whether the estimator vouches for the position."""
        lost_s = self.flight.navigation.lost_s(t)
        return t >= self._ready_at and lost_s < self.dead_reckoning_s

    def gcs_present(self, t: float) -> bool:
        """Whether a ground station was heard on any link lately; a companion does not count."""
        return any(t - heard < GCS_TIMEOUT_S for heard in self.gcs_heard.values())

    def gcs_on(self, link: int, t: float) -> bool:
        """The same for one link."""
        return t - self.gcs_heard.get(link, -math.inf) < GCS_TIMEOUT_S

    def charge_state(self) -> int:
        """MAV_BATTERY_CHARGE_STATE."""
        charge = self.flight.battery
        if charge <= 0.07:
            return int(mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL)
        if charge <= 0.15:
            return int(mavlink.MAV_BATTERY_CHARGE_STATE_LOW)
        return int(mavlink.MAV_BATTERY_CHARGE_STATE_OK)

    def log(self, line: str) -> None:
        """A line for whoever watches the process."""
        self._log(line)

    # Power and arming.

    def _start(self, t: float) -> None:
        """What a boot sets; the first and every other."""
        self._dark_until = t + DARK_AT_BOOT_S if self.boots else t
        self._reboot_at = math.inf
        least, most = self.ready_s
        spread = (self.flight.body.seed * 0.6180339887) % 1.0
        self._ready_at = self._dark_until + (least + spread * (most - least)) * self._boot_time
        self.clock.reboot(self._dark_until)
        self._streams = [Streams(rates, self._dark_until) for rates in self.rates_hz]
        self._queue.clear()
        self.gcs_heard.clear()
        self.armed = self.lifted = False
        self.home_local_enu = self.flight.position_enu.copy()
        self.on_boot(t)

    def reboot(self, t: float) -> None:
        """Restart the autopilot, in the air too: the motors stop."""
        self.boots += 1
        self.flight.reboot()
        self.flight.advance(t)
        self._start(t)
        self.log("rebooted")

    def reboot_soon(self, t: float) -> None:
        """Restart once the answer is out."""
        self._reboot_at = t

    def arm(self, t: float) -> None:
        """Motors on, whatever the checks say."""
        self.armed, self.armed_t, self.lifted = True, t, False
        self.home_local_enu = self.flight.position_enu.copy()
        self.on_armed(t)
        self.log("armed")

    def disarm(self, reason: str, t: float) -> None:
        """Motors off, in the air too."""
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
        self._out.append(Outgoing(link, message))

    def _send_id(self, message_id: int, link: int, t: float) -> bool:
        """Send a message of ours by id; False when there is none to send."""
        build = BUILDERS.get(message_id)
        if build is None:
            return False
        if message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT and self.faults.no_heartbeat:
            return True
        message = build(self, t)
        if message is None:
            return False
        self.send(link, message)
        return True

    def text_links(self, t: float) -> list[int]:
        """Links that get STATUSTEXT."""
        return list(range(len(self.rates_hz)))

    def tell(self, text: str, t: float, severity: int = mavlink.MAV_SEVERITY_CRITICAL) -> None:
        """STATUSTEXT in chunks of 50 bytes, and a line in the log."""
        self.log(text)
        data = (text + self.text_end).encode()
        chunks = [data[i : i + _CHUNK] for i in range(0, len(data), _CHUNK)]
        self._text_id = self._text_id % 65535 + 1
        number = self._text_id if len(chunks) > 1 else 0
        for link in self.text_links(t):
            for index, chunk in enumerate(chunks):
                self.send(link, mavlink.MAVLink_statustext_message(severity, chunk, number, index))

    def answer_first(self, link: int, message: Any) -> None:
        """Put a message before those already waiting."""
        self._out.insert(0, Outgoing(link, message))

    def send_slowly(self, link: int, messages: Iterable[Any]) -> None:
        """Put messages on a link a few per step."""
        self._queue.extend(Outgoing(link, message) for message in messages)

    # What commands of all personalities do.

    def request_message(self, message_id: int, link: int, t: float) -> bool:
        """REQUEST_MESSAGE; False when there is none to send."""
        return self._send_id(message_id, link, t)

    def set_interval(self, message_id: int, interval_us: float, link: int, t: float) -> bool:
        """SET_MESSAGE_INTERVAL; False for a message it does not have."""
        if message_id not in BUILDERS:
            return False
        self._streams[link].set_interval(message_id, interval_us, t)
        return True

    def interval_us(self, message_id: int, link: int) -> int:
        """Interval of a message on a link, -1 when not sent."""
        return self._streams[link].interval_us(message_id)
