"""Fault injection: lines such as `1 gps off` or `all battery 0.1`, by a call, by time, or over UDP."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ptnsbc_autopilot.vehicle import AutopilotError, Log, Request, StandInVehicle
from ptnsbc_io.mavlink.dialect import mavlink

_HOST = "127.0.0.1"
_LINE_BYTES = 4096
_STRONGEST_M_S = 60.0  # of a wind


def _choice(word: str, off: str, on: str, what: str) -> bool:
    if word not in (off, on):
        raise AutopilotError(f"fault {what} {word!r}: expected {off} or {on}")
    return word == on


def _number(word: str, what: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise AutopilotError(f"fault {what} {word!r}: expected a number")
    return value


def _gps(vehicle: StandInVehicle, word: str, t: float) -> None:
    if _choice(word, "off", "on", "gps"):
        vehicle.flight.navigation.regain()
    else:
        vehicle.flight.navigation.lose(t)


def _heartbeat(vehicle: StandInVehicle, word: str, _t: float) -> None:
    vehicle.faults.no_heartbeat = not _choice(word, "off", "on", "heartbeat")


def _radio(vehicle: StandInVehicle, word: str, _t: float) -> None:
    vehicle.faults.mute = not _choice(word, "off", "on", "radio")


def _arming(vehicle: StandInVehicle, word: str, _t: float) -> None:
    if word not in ("refuse", "deny", "allow"):
        raise AutopilotError(f"fault arming {word!r}: expected refuse, deny or allow")
    vehicle.faults.refuse_arming, vehicle.faults.deny_arming = word == "refuse", word == "deny"


def _takeoff(vehicle: StandInVehicle, word: str, t: float) -> None:
    if word == "now":  # its pilot does it, as high as its parameters say
        if not vehicle.armed:
            vehicle.arm(t)
        height = (0.0,) * 6 + (math.nan,)
        vehicle.fly(Request(mavlink.MAV_CMD_NAV_TAKEOFF, height, vehicle.system, 0), t)
        return
    vehicle.faults.takeoff_detected = _choice(word, "real", "detected", "takeoff")


def _duplicate(vehicle: StandInVehicle, word: str, _t: float) -> None:
    vehicle.faults.duplicate = _choice(word, "off", "on", "duplicate")


def _battery(vehicle: StandInVehicle, word: str, _t: float) -> None:
    charge = _number(word, "battery")
    if not 0.0 <= charge <= 1.0:
        raise AutopilotError(f"fault battery {word}: expected 0 to 1")
    vehicle.flight.battery = charge


def _wind(vehicle: StandInVehicle, word: str, _t: float) -> None:
    east_m_s = _number(word, "wind")
    if abs(east_m_s) > _STRONGEST_M_S:
        raise AutopilotError(
            f"fault wind {word}: expected -{_STRONGEST_M_S:g} to {_STRONGEST_M_S:g} m/s"
        )
    vehicle.flight.blow(east_m_s)


SENSORS = {
    "gyro": mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO,
    "accelerometer": mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL,
    "magnetometer": mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG,
    "barometer": mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE,
    "gps": mavlink.MAV_SYS_STATUS_SENSOR_GPS,
    "battery": mavlink.MAV_SYS_STATUS_SENSOR_BATTERY,
    "none": 0,
}
"""The sensors that may be reported as unhealthy, and their bits in SYS_STATUS."""


def _unhealthy(vehicle: StandInVehicle, word: str, _t: float) -> None:
    if word not in SENSORS:
        raise AutopilotError(f"fault unhealthy {word!r}: expected one of {', '.join(SENSORS)}")
    vehicle.faults.unhealthy = SENSORS[word]


def _mode(vehicle: StandInVehicle, word: str, t: float) -> None:
    if not vehicle.set_mode_by_rc(word, t):
        raise AutopilotError(f"fault mode {word!r}: expected a mode of this autopilot, as LAND")


FAULTS: dict[str, Callable[[StandInVehicle, str, float], None]] = {
    "gps": _gps,
    "heartbeat": _heartbeat,
    "radio": _radio,
    "arming": _arming,
    "takeoff": _takeoff,
    "unhealthy": _unhealthy,
    "alarm": lambda vehicle, word, t: vehicle.send_text(f"Alarm: {word}", t),
    "duplicate": _duplicate,
    "battery": _battery,
    "clock": lambda vehicle, word, _t: vehicle.clock.jump(_number(word, "clock")),
    "mode": _mode,
    "jump": lambda vehicle, word, _t: vehicle.flight.navigation.jump(_number(word, "jump")),
    "wind": _wind,
    "reboot": lambda vehicle, _word, t: vehicle.reboot(t),
}


def inject(vehicle: StandInVehicle, what: str, value: str, t: float) -> None:
    """Inject a fault or take it back: see FAULTS.

    Raises:
        AutopilotError: there is no such fault, or it takes no such value.
    """
    if what not in FAULTS:
        raise AutopilotError(f"fault {what!r}: expected one of {', '.join(FAULTS)}")
    FAULTS[what](vehicle, value, t)
    vehicle.log(f"fault: {what} {value}".rstrip())


def run_fault_line(vehicles: Sequence[StandInVehicle], line: str, t: float) -> str:
    """Run one fault line, for one system id or `all`; returns `ok`, or the states as JSON.

    Raises:
        AutopilotError: the line is not a fault, or names no vehicle.
    """
    system, what, value, *rest = (*line.split(), "", "", "")
    chosen = [v for v in vehicles if system in ("all", str(v.system))]
    if not chosen or not what or any(rest):
        known = ", ".join(str(v.system) for v in vehicles)
        raise AutopilotError(f"{line!r}: expected SYSTEM FAULT VALUE, with SYSTEM of {known}, all")
    if what == "state":
        return json.dumps([state(vehicle) for vehicle in chosen])
    for vehicle in chosen:
        inject(vehicle, what, value, t)
    return "ok"


def state(vehicle: StandInVehicle) -> dict[str, Any]:
    """The true state of a vehicle, for tests and demonstrations."""
    flight = vehicle.flight
    return {
        "system": vehicle.system,
        "armed": vehicle.armed,
        "mode": vehicle.mode_name,
        "contact": vehicle.in_contact,
        "position_enu_m": flight.truth.position_enu.tolist(),
        "velocity_enu_m_s": flight.truth.velocity_enu.tolist(),
        "origin_enu_m": flight.navigation.origin_enu.tolist(),
        "battery": flight.battery,
    }


class TimedFault(NamedTuple):
    """A fault line and its time, in seconds from the start."""

    at_s: float
    line: str


def parse_timed_fault(text: str) -> TimedFault:
    """`20 1 gps off`: seconds from the start, then a fault line.

    Raises:
        AutopilotError: the text does not begin with a time.
    """
    first, _, line = text.strip().partition(" ")
    try:
        at_s = float(first)
    except ValueError:
        at_s = math.nan
    if not (math.isfinite(at_s) and at_s >= 0.0 and line.strip()):
        raise AutopilotError(
            f'fault "{text}": expected SECONDS SYSTEM FAULT VALUE, as "20 1 gps off"'
        )
    return TimedFault(at_s, line)


class FaultPort:
    """Runs fault lines from a UDP port of this host, and timed ones; call `poll` every tick."""

    def __init__(
        self,
        vehicles: Sequence[StandInVehicle],
        start_t: float,
        *,
        port: int | None = None,
        timed: Sequence[TimedFault] = (),
        log: Log,
    ) -> None:
        self._vehicles = vehicles
        self._start_t = start_t
        self._port = port
        self._timed = sorted(timed, key=lambda fault: fault.at_s)
        self._log = log
        self._socket: socket.socket | None = None

    def __enter__(self) -> FaultPort:
        if self._port is None:
            return self
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((_HOST, self._port))
        except OSError as error:
            self._socket.close()
            raise AutopilotError(
                f"control port {self._port}: {error.strerror}; expected a free one"
            ) from None
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket is not None:
            self._socket.close()

    def poll(self, now: float) -> None:
        """Run the faults that are due and those that have arrived."""
        while self._timed and now - self._start_t >= self._timed[0].at_s:
            self._log(self._run(self._timed.pop(0).line, now))
        while self._socket is not None:
            try:
                data, sender = self._socket.recvfrom(_LINE_BYTES)
            except (BlockingIOError, ConnectionRefusedError):
                return
            answer = self._run(data.decode(errors="replace").strip(), now)
            try:
                self._socket.sendto(answer.encode(), sender)
            except OSError:
                continue

    def _run(self, line: str, now: float) -> str:
        try:
            return run_fault_line(self._vehicles, line, now)
        except AutopilotError as error:
            return f"error: {error}"


def send_fault(port: int, line: str, timeout_s: float = 2.0) -> str:
    """Send a fault line to the control port of a running stand-in; returns the answer.

    Raises:
        AutopilotError: no answer comes, or the stand-in refuses the line.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as channel:
        channel.settimeout(timeout_s)
        try:
            channel.connect((_HOST, port))
            channel.send(line.encode())
            answer = channel.recv(_LINE_BYTES).decode()
        except OSError:
            raise AutopilotError(
                f"control port {port}: no answer; expected a stand-in with --control {port}"
            ) from None
    if answer.startswith("error: "):
        raise AutopilotError(answer.removeprefix("error: "))
    return answer
