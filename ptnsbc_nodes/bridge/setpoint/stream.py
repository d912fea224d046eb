"""The setpoint stream: what is sent at each tick, for whatever the procedure asks of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.kinematics import rotation_from_quaternion, yaw_of
from ptnsbc_core.trajectory import reference
from ptnsbc_core.types import AgentConfig, Array
from ptnsbc_io.mavlink.autopilots import Autopilot
from ptnsbc_nodes.bridge.controller import SetpointReply, wanted_yaw
from ptnsbc_nodes.bridge.procedure.steps import Stream
from ptnsbc_nodes.bridge.setpoint.attitude import (
    AttitudeTarget,
    PointHold,
    from_wrench,
    pointing,
    tilt_limited,
    understood,
)
from ptnsbc_nodes.bridge.setpoint.body_rates import BodyRateEstimator
from ptnsbc_nodes.bridge.setpoint.guard import SetpointGuard
from ptnsbc_nodes.bridge.setpoint.hover_thrust import HoverThrust
from ptnsbc_nodes.bridge.setpoint.messages import Setpoints
from ptnsbc_sim.scenario.mavlink import SetpointKind

_CLIMB_M_S = 1.0
_TURN_RAD_S = 0.7
_TURNED_RAD = 0.2
_AHEAD_M = 1.0  # a target no farther above the vehicle than this
_LEASH_M = 1.5
_LONGEST_STEP_S = 0.1
_ALL_AXES = np.ones(3, dtype=bool)
_PUSH_S = 0.1  # smoothing of the feed-forward: the planner passes the noise of positions on


class HoldPoint:
    """A point to be at and a heading to keep."""

    def __init__(self, odometry: Array) -> None:
        self.position = odometry[0:3].copy()  # (3,) [m], world
        self.yaw = yaw_of(odometry)


class SetpointStream:
    """Turns orders and wishes into messages; the world frame ends here."""

    def __init__(
        self,
        autopilot: Autopilot,
        kind: SetpointKind,
        config: AgentConfig,
        guard: SetpointGuard,
        messages: Setpoints,
        hover: HoverThrust,
        feed_forward: bool,
        climb_to_m: float,
    ) -> None:
        self._autopilot = autopilot
        self._kind = kind
        self._config = config
        self._guard = guard
        self._messages = messages
        self._climb_to_m = climb_to_m
        self._heading = reference(config.trajectory, 0.0).yaw
        self._feed_forward = feed_forward
        self._point_hold = PointHold(config.controller.gravity)
        self._turning = BodyRateEstimator()
        self.hover = hover
        self._carried = Stream.NONE
        self._place: HoldPoint | None = None
        self._climb: HoldPoint | None = None
        self._ground_m = 0.0
        self._reference: Array | None = None  # of position_velocity
        self._last: Array | None = None  # velocity setpoint before, for the feed-forward
        self._pushed = np.zeros(3)
        self._now_s = float("inf")
        self._dt = 0.0

    def turned(self, odometry: Array) -> bool:
        """Whether the vehicle has the heading with which the formation begins, where it climbed by itself."""
        return (
            self._climb is None or abs(wrap_angle(yaw_of(odometry) - self._heading)) < _TURNED_RAD
        )

    def message(
        self,
        carried: Stream,
        now_s: float,
        odometry: Array,
        offset: Array,
        wanted: SetpointReply | None,
        armed: bool,
        flight_s: float,
    ) -> Any:
        """The setpoint of this tick; None when there must be none.

        Args:
            carried: what the procedure asks for.
            now_s: steady clock.
            odometry: newest state (13,), world frame.
            offset: world position of the vehicle's local origin (3,) [m].
            wanted: newest setpoint of the UAV process.
            armed: a disarmed vehicle is held where it stands, wherever that is.
            flight_s: time since the first epoch [s], negative before it.
        """
        self._dt = min(max(now_s - self._now_s, 0.0), _LONGEST_STEP_S)
        self._now_s = now_s
        if carried is not self._carried or not armed:
            self._begin(carried, odometry, armed)
        if carried is Stream.PLANNER and wanted is not None:
            return self._planned(wanted, odometry, offset, flight_s)
        if carried is Stream.CLIMB:
            return self._held(self._climbing(odometry), odometry, offset, armed)
        if carried is Stream.HOLD and self._place is not None:
            return self._held(self._place, odometry, offset, armed)
        return None

    def _begin(self, carried: Stream, odometry: Array, armed: bool) -> None:
        self._carried = carried
        self._place = HoldPoint(odometry)
        self._reference = self._last = None
        self._turning = BodyRateEstimator()
        if not armed:
            self._climb, self._ground_m = None, float(odometry[2])
            self._point_hold.reset()

    def _climbing(self, odometry: Array) -> HoldPoint:
        """Straight up from where it stood, at a walking pace, turning to the formation's heading; then stay.

        A formation that begins with a turn swings: the wrench tells tilt and heading as one rotation.
        """
        if self._climb is None:
            self._climb = HoldPoint(odometry)
        place, height = self._climb, float(odometry[2])
        most = self._dt * _TURN_RAD_S
        place.yaw = wrap_angle(
            place.yaw + min(max(wrap_angle(self._heading - place.yaw), -most), most)
        )
        pace = min(_CLIMB_M_S, self._guard.limits.up_m_s)
        up = min(place.position[2] + self._dt * pace, height + _AHEAD_M)
        place.position[2] = min(up, self._ground_m + self._climb_to_m)
        return place

    def _held(self, place: HoldPoint, odometry: Array, offset: Array, armed: bool) -> Any:
        position = self._guard.place(place.position)
        if not self._autopilot.attitude_only:
            return self._messages.place(self._now_s, position - offset, place.yaw)
        if not armed:  # nothing may turn before the vehicle is meant to lift
            level = AttitudeTarget(odometry[3:7], np.zeros(3), 0.0)
            return self._messages.attitude(self._now_s, level)
        pull = self._point_hold.force_per_kg(odometry, position, self._dt)
        quaternion = tilt_limited(pointing(pull, place.yaw), self._guard.limits.tilt_rad)
        along = float(pull @ rotation_from_quaternion(odometry[3:7])[:, 2])
        rates = self._turning.of(quaternion, _ALL_AXES, self._now_s)
        return self._pulled(quaternion, rates, along)

    def _planned(
        self, wanted: SetpointReply, odometry: Array, offset: Array, flight_s: float
    ) -> Any:
        controller = self._config.controller
        if self._kind == "attitude":
            quaternion = from_wrench(
                wanted.values,
                wanted.told.odometry,
                flight_s,
                controller,
                self._guard.limits.tilt_rad,
            )
            known = understood(wanted.values, controller)
            rates = self._turning.of(quaternion, known, wanted.told.sampled_s)
            return self._pulled(quaternion, rates, wanted.values[2] / controller.nominal[0])
        velocity = self._guard.velocity(wanted.values[0:3], odometry[0:3])
        yaw = wanted_yaw(wanted, controller.attitude_gain[1])
        push = self._push(velocity) if self._feed_forward else None
        if self._kind == "velocity":
            return self._messages.velocity(self._now_s, velocity, push, yaw)
        place = self._guard.place(self._referred(velocity, odometry)) - offset
        return self._messages.both(self._now_s, place, velocity, push, yaw)

    def _pulled(self, quaternion: Array, rates: Array, pull_m_s2: float) -> Any:
        mass = self._config.controller.nominal[0]
        thrust = self.hover.normalised(pull_m_s2 * mass, mass)
        self.hover.sent(thrust)
        return self._messages.attitude(self._now_s, AttitudeTarget(quaternion, rates, thrust))

    def _referred(self, velocity: Array, odometry: Array) -> Array:
        """Where the velocity setpoints lead, no farther from the vehicle than a leash.

        With both loops closed, the planner's and the vehicle's, the reference is an integral: it ends
        where the vehicle is where the planner wants it, whatever its velocity estimate drifts by.
        """
        if self._reference is None:
            self._reference = odometry[0:3].copy()
        self._reference = self._reference + self._dt * velocity
        off = self._reference - odometry[0:3]
        distance = float(np.sqrt(off @ off))
        if distance > _LEASH_M:
            self._reference = odometry[0:3] + off * (_LEASH_M / distance)
        return np.asarray(self._reference)

    def _push(self, velocity: Array) -> Array:
        """Rate of change of the setpoint (3,) [m/s^2], smoothed, within the vehicle's limit."""
        last, self._last = self._last, velocity
        if last is None or self._dt <= 0.0:
            self._pushed = np.zeros(3)
            return self._pushed
        limit = self._guard.limits.acceleration_m_s2
        rate = np.clip((velocity - last) / self._dt, -limit, limit)
        share = self._dt / (_PUSH_S + self._dt)
        self._pushed = self._pushed + share * (rate - self._pushed)
        return np.asarray(self._pushed)
