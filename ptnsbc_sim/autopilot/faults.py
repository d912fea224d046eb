"""What a test or a demonstration can break in a stand-in, in words: `1 gps off`, `all battery 0.1`."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_sim.autopilot.codec import AutopilotError

if TYPE_CHECKING:
    from ptnsbc_sim.autopilot.vehicle import StandInVehicle

IMPOSTOR_PERIOD_S = 0.2
_IMPOSTOR_OLDER_MS = 90_000


@dataclass
class Faults:
    """Faults that last until they are taken back."""

    no_heartbeat: bool = False
    mute: bool = False  # neither sends nor answers, flies on
    refuse_arming: bool = False
    duplicate: bool = False  # somebody else sends with our system id


def impostor(vehicle: StandInVehicle, t: float) -> list[Any]:
    """What somebody with our system id sends: disarmed, 50 m north of our origin, booted long before us."""
    flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    return [
        mavlink.MAVLink_heartbeat_message(
            vehicle.mav_type, vehicle.autopilot, flags, 0, mavlink.MAV_STATE_STANDBY, 3
        ),
        mavlink.MAVLink_local_position_ned_message(
            vehicle.clock.ms(t) + _IMPOSTOR_OLDER_MS, 50.0, 0, 0, 0, 0, 0
        ),
    ]


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
    vehicle.faults.refuse_arming = not _choice(word, "refuse", "allow", "arming")


def _duplicate(vehicle: StandInVehicle, word: str, _t: float) -> None:
    vehicle.faults.duplicate = _choice(word, "off", "on", "duplicate")


def _battery(vehicle: StandInVehicle, word: str, _t: float) -> None:
    charge = _number(word, "battery")
    if not 0.0 <= charge <= 1.0:
        raise AutopilotError(f"fault battery {word}: expected 0 to 1")
    vehicle.flight.battery = charge


def _clock(vehicle: StandInVehicle, word: str, _t: float) -> None:
    vehicle.clock.jump(_number(word, "clock"))


def _mode(vehicle: StandInVehicle, word: str, t: float) -> None:
    if not vehicle.pilot(word, t):
        raise AutopilotError(f"fault mode {word!r}: expected a mode of this autopilot, as LAND")


def _reboot(vehicle: StandInVehicle, _word: str, t: float) -> None:
    vehicle.reboot(t)


FAULTS: dict[str, Callable[[StandInVehicle, str, float], None]] = {
    "gps": _gps,
    "heartbeat": _heartbeat,
    "radio": _radio,
    "arming": _arming,
    "duplicate": _duplicate,
    "battery": _battery,
    "clock": _clock,
    "mode": _mode,
    "reboot": _reboot,
}


def inject(vehicle: StandInVehicle, what: str, value: str, t: float) -> None:
    """Break or mend something: see FAULTS.

    Raises:
        AutopilotError: there is no such fault, or it takes no such value.
    """
    if what not in FAULTS:
        raise AutopilotError(f"fault {what!r}: expected one of {', '.join(FAULTS)}")
    FAULTS[what](vehicle, value, t)
    vehicle.log(f"fault: {what} {value}".rstrip())


def obey(vehicles: Sequence[StandInVehicle], line: str, t: float) -> str:
    """Do what a line says, for one system id or `all`; the answer, `ok` or the states asked for.

    Raises:
        AutopilotError: the line says nothing that can be done.
    """
    who, what, value, *rest = (*line.split(), "", "", "")
    chosen = [v for v in vehicles if who in ("all", str(v.system))]
    if not chosen or not what or any(rest):
        known = ", ".join(str(v.system) for v in vehicles)
        raise AutopilotError(f"{line!r}: expected SYSTEM FAULT VALUE, with SYSTEM of {known}, all")
    if what == "state":
        return json.dumps([state(vehicle) for vehicle in chosen])
    for vehicle in chosen:
        inject(vehicle, what, value, t)
    return "ok"


def state(vehicle: StandInVehicle) -> dict[str, Any]:
    """What is true of a vehicle, for those who judge from outside."""
    flight = vehicle.flight
    return {
        "system": vehicle.system,
        "armed": vehicle.armed,
        "mode": vehicle.mode_name,
        "contact": vehicle.in_contact,
        "position_enu_m": flight.truth_enu.tolist(),
        "velocity_enu_m_s": flight.true_velocity_enu.tolist(),
        "origin_enu_m": flight.navigation.origin_enu.tolist(),
        "battery": flight.battery,
    }
