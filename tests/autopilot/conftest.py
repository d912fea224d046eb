"""A companion computer in the same process: real bytes both ways, time handed in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from ptnsbc_autopilot.physics.body import VehicleDescription
from ptnsbc_autopilot.physics.navigation import QUALITIES
from ptnsbc_autopilot.server import Codec
from ptnsbc_autopilot.vehicle import COMPANION, GCS, StandInVehicle
from ptnsbc_io.mavlink.dialect import mavlink

STEP_S = 0.004
VELOCITY_YAW = 0x09C7  # position, acceleration and yaw rate ignored


class Companion:
    """Speaks to one vehicle; keeps all it sent, by type."""

    def __init__(self, vehicle: StandInVehicle) -> None:
        self.vehicle = vehicle
        self.t = 0.0
        self._heard: list[tuple[float, int, Any]] = []
        self._waiting: list[tuple[float, int, bytes]] = []
        self._here = {COMPANION: Codec(245, 191), GCS: Codec(255, 190)}
        self._there = {link: Codec(vehicle.system) for link in (COMPANION, GCS)}

    @property
    def heard(self) -> list[tuple[float, int, Any]]:
        """All that came, decoded when somebody looks."""
        waiting, self._waiting = self._waiting, []
        for t, link, packet in waiting:
            self._heard += [(t, link, m) for m in self._here[link].decode(packet)]
        return self._heard

    def _take(self, outgoing: Any) -> None:
        for link, message in outgoing:
            self._waiting.append((self.t, link, self._there[link].encode(message)))

    def send(self, message: Any, link: int = COMPANION) -> list[Any]:
        """Send one message; what came back at once."""
        answers: list[Any] = []
        for parsed in self._there[link].decode(self._here[link].encode(message)):
            out = self.vehicle.handle(parsed, link, self.t)
            if out:
                before = len(self.heard)
                self._take(out)
                answers += [m for _, _, m in self.heard[before:]]
        return answers

    def command(self, command: int, *params: float, target: int = 1) -> int | None:
        """COMMAND_LONG; the result of its ack, None without one."""
        padded = (*params, *(0.0,) * (7 - len(params)))
        message = mavlink.MAVLink_command_long_message(target, 1, command, 0, *padded)
        acks = [m for m in self.send(message) if m.get_type() == "COMMAND_ACK"]
        return acks[0].result if acks else None

    def run(self, seconds: float, each: Callable[[], Any] | None = None, hz: float = 20.0) -> None:
        """Let time pass; `each()` is called at a rate."""
        end = self.t + seconds
        due = self.t
        while self.t < end - 1e-9:
            if each is not None and self.t >= due:
                each()
                due += 1.0 / hz
            self.t += STEP_S
            self._take(self.vehicle.step(self.t))

    def target(
        self,
        *,
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        position: tuple[float, float, float] = (0.0, 0.0, 0.0),
        acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0),
        yaw: float = 0.0,
        yaw_rate: float = 0.0,
        mask: int = VELOCITY_YAW,
        frame: int = mavlink.MAV_FRAME_LOCAL_NED,
        system: int = 1,
        component: int = 1,
    ) -> None:
        """One SET_POSITION_TARGET_LOCAL_NED."""
        vectors = (*position, *velocity, *acceleration)
        self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, system, component, frame, mask, *vectors, yaw, yaw_rate
            )
        )

    def velocity(self, north: float, east: float, down: float) -> None:
        """One velocity setpoint, facing north."""
        self.target(velocity=(north, east, down))

    def offboard(self) -> int | None:
        """Ask PX4 for OFFBOARD."""
        return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 6, 0)

    def arm(self, *, force: bool = False) -> int | None:
        """Ask for motors."""
        return self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, 21196 if force else 0)

    def disarm(self, *, force: bool = False) -> int | None:
        """Ask for no motors."""
        return self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196 if force else 0)

    def put(self, name: str, value: float) -> None:
        """Set a parameter, past the protocol."""
        self.vehicle.parameters.put(name, value)

    def airborne(self, seconds: float = 8.0) -> None:
        """PX4 in OFFBOARD, a few metres up, holding still."""
        self.flown(0, 0, 0, 1.2)
        assert (self.offboard(), self.arm()) == (0, 0)
        self.flown(0, 0, -1, seconds)
        self.flown(0, 0, 0, 2)
        assert self.vehicle.flight.truth.position_enu[2] > 1

    def flown(self, north: float, east: float, down: float, seconds: float) -> None:
        """Stream a velocity for a time."""
        self.run(seconds, lambda: self.velocity(north, east, down))

    def got(self, name: str, link: int = COMPANION, since: float = -1.0) -> list[Any]:
        """Messages of a type on a link."""
        return [m for t, on, m in self.heard if m.get_type() == name and on == link and t > since]

    def last(self, name: str, link: int = COMPANION) -> Any:
        """The latest of a type."""
        return self.got(name, link)[-1]

    def texts(self, link: int = COMPANION) -> list[str]:
        """Texts of STATUSTEXT."""
        return [m.text for m in self.got("STATUSTEXT", link)]

    def gcs_heartbeat(self, link: int = GCS) -> None:
        """A ground station shows itself."""
        self.send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3), link)


@pytest.fixture
def companion() -> Callable[..., Companion]:
    """Makes a vehicle of a class, booted and ready, and a companion for it."""

    def make(kind: type[StandInVehicle], *, ready: bool = True, **changes: Any) -> Companion:
        boot_time = changes.pop("boot_time", 0.0 if ready else 1.0)
        made = Companion(
            kind(
                1,
                VehicleDescription(**{"quality": QUALITIES["perfect"], "seed": 3, **changes}),
                0.0,
                boot_time=boot_time,
            )
        )
        made.run(0.1)
        return made

    return make
