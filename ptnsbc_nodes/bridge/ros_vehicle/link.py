"""A link to a vehicle behind topics and services of ROS 2, in the words of MAVLink: its bridge is that of any vehicle.

What a vehicle reports becomes ODOMETRY, HEARTBEAT and EXTENDED_SYS_STATE; requests and setpoints are calls of methods.
No bytes of MAVLink are made of them.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import Array
from ptnsbc_io.mavlink import frames
from ptnsbc_io.mavlink.autopilots import ROS
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_io.mavlink.timesync import TimeSync
from ptnsbc_nodes.bridge.procedure.steps import CommandRequest
from ptnsbc_nodes.bridge.ros_vehicle.velocity_filter import VelocityFilter
from ptnsbc_nodes.comm.door import Refusals

_HEARTBEAT_S, _GROUND_M, _STILL_M_S = 1.0, 0.15, 0.2  # it is down within this of where it was armed
_UNKNOWN = [float("nan")] * 21  # covariances
_MOST_WAITING = 200  # messages; a flood must not delay the setpoint stream
_SILENT_S, _LONGEST_S = 0.5, 1 / 20  # between two poses: without one, and with too few of them
_LATE, _OF_MEAN, _OFF_NORM = 1.25, 0.1, 0.05  # a busy computer is late at times
_IGNORED = tuple(
    getattr(mavlink, f"POSITION_TARGET_TYPEMASK_{axis}_IGNORE") for axis in ("X", "VX", "AX")
)


Given = Array | None


class RosLink:
    """The link of a bridge in place of a MavlinkLink; the vehicle reports from any thread."""

    signed, peer, duplicate_sysid_s, resumed = False, None, None, False
    ignored: frozenset[int] = frozenset()
    source = "the vehicle"
    """The origin of its poses, for messages."""

    def __init__(self, steady_s: Callable[[], float] = time.monotonic) -> None:
        self.received = self.sent = self.unsent = 0
        self._steady_s, self._began_s = steady_s, steady_s()
        self.refusals = Refusals()
        self.counts = self.refusals.counts
        self.armed, self.mode = False, FlightMode.HOLD
        self.landed: bool | None = None  # by the vehicle's own word
        self.silent = False  # it is being asked to land: a setpoint that overtakes the call would end the landing
        self.position, self.velocity = np.zeros(3), np.zeros(3)  # newest [m], ENU; [m/s], FLU
        self._ground_m = 0.0  # height of the place of arming
        self._sync, self._filter = TimeSync(), VelocityFilter()
        self._arrived, self._waiting = threading.Event(), deque[Any](maxlen=_MOST_WAITING)
        self.wait = self._arrived.wait  # until the vehicle has reported something, or for a time
        self._told, self._next_s = (False, self.mode, False), 0.0
        self.missing = ""  # why it cannot be flown: what it lacks before it is armed, and its pose
        self._lacks, self._posed_s, self._period_s = "", steady_s(), 0.0

    def fly(self, position: Given, velocity: Given, acceleration: Given, yaw: float) -> None:
        """Send a setpoint (3,) [m, m/s, m/s^2], ENU, with a heading [rad]; what is None is left to the vehicle."""

    def request(self, request: CommandRequest) -> None:
        """Ask the vehicle for something. It is repeated until the vehicle shows it."""

    def alive(self) -> bool:
        """True if the vehicle would hear a request now."""
        return True

    def lacks(self) -> str:
        """The reason why it must not be armed, asked once a second; empty without one."""
        if self._period_s <= _LATE * _LONGEST_S:
            return ""
        return f"{1 / self._period_s:.1f} poses a second: expected {1 / _LONGEST_S:g} or more"

    @property
    def down(self) -> bool:
        """True if it stands: by its own word, else disarmed, or low and still after it was told to land."""
        low = self.position[2] < self._ground_m + _GROUND_M
        still = self.velocity @ self.velocity < _STILL_M_S**2
        down = not self.armed or (self.mode is FlightMode.LAND and low and still)
        return bool(down if self.landed is None else self.landed)

    def pose(self, stamp_ns: int, position: Array, quaternion: Array, *moving: Array) -> None:
        """It was at `position` (3,) [m] with attitude (4,) x y z w at a time of its own clock, 0: now; ENU and FLU.

        `moving`: velocity (3,) [m/s] and rates (3,) [rad/s] of the body; without them the velocity is estimated.
        """
        numbers = np.concatenate((position, quaternion, *moving))
        if not (np.isfinite(numbers).all() and abs(math.hypot(*quaternion) - 1.0) < _OFF_NORM):
            why = f"{numbers}: expected finite numbers, and a quaternion of norm 1"
            return self.refusals.add(self.source, why)
        now_s = self._steady_s()
        self._period_s += _OF_MEAN * (now_s - self._posed_s - self._period_s)
        self._posed_s, self.refusals.newest = now_s, ""
        stamp_s = seconds(stamp_ns) if stamp_ns else now_s
        # Its clock is as far off as the fastest message says.
        self._sync.on_boot_time(stamp_s, now_s)
        sampled_s = self._sync.to_host_time(stamp_s) or now_s
        if not moving:
            velocity = self._filter.update(sampled_s, position)
            moving = (rotation_from_quaternion(quaternion).T @ velocity, np.zeros(3))
        self.position, self.velocity = position, moving[0]
        self._ground_m = self._ground_m if self.armed else float(position[2])
        told = (
            *frames.vector_enu_to_ned(position).tolist(),
            frames.quaternion_enu_flu_to_ned_frd(quaternion).tolist(),
            *(number for vector in moving for number in frames.vector_flu_to_frd(vector).tolist()),
        )
        age_us = max(round(1e6 * (sampled_s - self._began_s)), 0)
        axes = mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_BODY_FRD
        self.report(mavlink.MAVLink_odometry_message(age_us, *axes, *told, _UNKNOWN, _UNKNOWN))

    def report(self, message: Any = None, **state: Any) -> None:
        """A message of MAVLink in the vehicle's name, or its state by its own word: `armed`, `landed`, `mode`."""
        for name, value in state.items():
            setattr(self, name, value)
        if message is not None:
            self._waiting.append(message)
        self._arrived.set()

    def done(self, request: CommandRequest) -> None:
        """The vehicle has accepted a request, and says nothing of its state itself."""
        if request is CommandRequest.OWN_MODE:
            self.report(mode=FlightMode.OWN)
        elif request is CommandRequest.ARM:
            self.report(armed=True)
        elif request is CommandRequest.LAND:
            self.report(mode=FlightMode.LAND)
        elif request in (CommandRequest.DISARM, CommandRequest.KILL):
            self.report(armed=False, mode=FlightMode.HOLD)

    def say(self, text: str, severity: int = mavlink.MAV_SEVERITY_WARNING) -> None:
        """A text of the vehicle, as why it has refused a request."""
        self.report(mavlink.MAVLink_statustext_message(severity, text.encode()))

    def poll(self, now_s: float) -> Iterator[Any]:
        """The reports of the vehicle, and a heartbeat every second and with every change."""
        self._arrived.clear()
        why = self.refusals.newest or f"nothing on {self.source}"
        why = f"no position from the vehicle: {why}" * (now_s - self._posed_s > _SILENT_S)
        self.missing = self._lacks or why
        if self.resumed:
            self.armed, self.mode, self.resumed = True, FlightMode.OWN, False
        while self._waiting:
            self.received += 1
            yield self._waiting.popleft()
        state = armed, mode, down = (self.armed, self.mode, self.down)
        if now_s < self._next_s and state == self._told:
            return
        self._told, self._next_s = state, now_s + _HEARTBEAT_S
        self._lacks = "" if armed or now_s < self._began_s + 2 * _HEARTBEAT_S else self.lacks()
        if self.alive():
            base = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
            who, standby = (mavlink.MAV_TYPE_QUADROTOR, ROS.number), mavlink.MAV_STATE_STANDBY
            number, _ = ROS.mode_numbers(mode)
            yield mavlink.MAVLink_heartbeat_message(*who, base, number, standby, 3)
            ground, air = mavlink.MAV_LANDED_STATE_ON_GROUND, mavlink.MAV_LANDED_STATE_IN_AIR
            yield mavlink.MAVLink_extended_sys_state_message(0, ground if down else air)

    def send(self, message: Any) -> bool:
        """Pass a setpoint on, and answer what is asked of a flight controller."""
        m, kind = message, message.get_type()
        if kind == "SET_POSITION_TARGET_LOCAL_NED":
            if self.silent or self.mode is FlightMode.LAND:
                return True  # ignored as by a flight controller: a driver may take it for the end of the landing
            vectors = (m.x, m.y, m.z), (m.vx, m.vy, m.vz), (m.afx, m.afy, m.afz)
            given = (
                None if m.type_mask & ignored else frames.vector_ned_to_enu(np.array(vector))
                for vector, ignored in zip(vectors, _IGNORED, strict=True)
            )
            return self._call(self.fly, *given, frames.yaw_enu_to_ned(m.yaw))
        if kind == "TIMESYNC" and m.tc1 == 0:  # times of the reports are ours
            tc1 = m.ts1 - nanoseconds(self._began_s)
            self.report(mavlink.MAVLink_timesync_message(tc1, m.ts1))
        elif kind == "COMMAND_LONG" and m.param1 == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            self._next_s = 0.0
        return True

    def command(self, request: CommandRequest, _message: Any) -> bool:
        """Pass a request on; pre-arm checks are a matter of flight controllers."""
        return request is CommandRequest.CHECK or self._call(self.request, request)

    def close(self) -> None:
        """Let go of the vehicle: its topics go with the node."""

    def _call(self, function: Callable[..., None], *values: Any) -> bool:
        try:
            function(*values)
        except Exception as error:  # of a class of the user
            self.unsent += 1
            text = f"{type(self).__name__}: {type(error).__name__}: {error}"
            self.say(text, mavlink.MAV_SEVERITY_CRITICAL)
            return False
        self.sent += 1
        return True
