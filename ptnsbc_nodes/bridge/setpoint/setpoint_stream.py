"""The setpoint stream: the message that is sent at each tick, as the procedure requests it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from inspect import unwrap
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.algebra import wrap_angle
from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.kinematics import velocity_enu, yaw_of
from ptnsbc_core.types import AgentConfig, Array
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS, VelocityResponse, limits, velocity_response
from ptnsbc_io.mavlink.setpoints import AttitudeTarget, SetpointMessages
from ptnsbc_nodes.bridge.procedure.steps import Stream
from ptnsbc_nodes.bridge.setpoint.attitude_targets import AttitudeTargets, largest_force_kappa_1_s
from ptnsbc_nodes.bridge.setpoint.setpoint_guard import SetpointGuard, allowed
from ptnsbc_nodes.bridge.setpoint.velocity_lead import (
    DragEstimator,
    FollowingEstimator,
    VelocityLead,
    largest_kappa_1_s,
)
from ptnsbc_nodes.bridge.state_publisher import SetpointReply
from ptnsbc_nodes.runtime.pacing import Latency
from ptnsbc_sim.scenario.mavlink import Mavlink, VehicleLink

_CLIMB_M_S = 1.0
_TURN_RAD_S = 0.7
_HEADING_TOLERANCE_RAD = 0.2
_AHEAD_M = 1.0  # the climbing target is at most this far above the vehicle
_LEASH_M = 1.5
_MAX_STEP_S = 0.1
_TILT_LAG_S = 0.165  # behind an attitude target, unless vehicles.N.tilt_lag_s says it
_SMOOTHING_S = 0.1  # of the feed-forward: the planner passes the noise of positions on


class _HoldPoint:
    """A position to hold and a heading to keep."""

    def __init__(self, odometry: Array) -> None:
        self.position = odometry[0:3].copy()  # (3,) [m], world
        self.yaw = yaw_of(odometry)


class _Climb:
    """The take-off by setpoints: straight up at a walking pace while turning to the formation's heading.

    A formation that begins with a turn swings, because the wrench gives tilt and heading as one rotation.
    """

    def __init__(self, height_m: float, heading: float) -> None:
        self._height_m = height_m
        self._heading = heading
        self._ground_m = 0.0
        self._target: _HoldPoint | None = None

    def reset(self, ground_m: float) -> None:
        """The vehicle stands on the ground at this height of the world."""
        self._target, self._ground_m = None, ground_m

    def heading_reached(self, odometry: Array) -> bool:
        """True if the vehicle has the heading with which the formation begins, if it climbed by setpoints."""
        error = wrap_angle(yaw_of(odometry) - self._heading)
        return self._target is None or abs(error) < _HEADING_TOLERANCE_RAD

    def target(self, odometry: Array, dt: float, up_m_s: float) -> _HoldPoint:
        if self._target is None:
            self._target = _HoldPoint(odometry)
        target, turn = self._target, dt * _TURN_RAD_S
        target.yaw = wrap_angle(
            target.yaw + min(max(wrap_angle(self._heading - target.yaw), -turn), turn)
        )
        up = min(target.position[2] + dt * min(_CLIMB_M_S, up_m_s), float(odometry[2]) + _AHEAD_M)
        target.position[2] = min(up, self._ground_m + self._height_m)
        return target


class _VelocityIntegral:
    """The quantities derived from the sequence of velocity setpoints: a reference position and an acceleration."""

    def __init__(self) -> None:
        self._reference: Array | None = None
        self._last: Array | None = None
        self._acceleration = np.zeros(3)

    def restart(self) -> None:
        """The next velocity begins a new sequence."""
        self._reference = self._last = None

    def position(self, velocity: Array, odometry: Array, dt: float) -> Array:
        """The position to which the velocity setpoints lead, at most a leash away from the vehicle.

        The planner and the vehicle both close a loop, and the reference is the integral between them. It
        settles where the vehicle is where the planner wants it, even if the velocity estimate drifts.
        """
        if self._reference is None:
            self._reference = odometry[0:3].copy()
        self._reference = self._reference + dt * velocity
        off = self._reference - odometry[0:3]
        distance = float(np.sqrt(off @ off))
        if distance > _LEASH_M:
            self._reference = odometry[0:3] + off * (_LEASH_M / distance)
        return np.asarray(self._reference)

    def acceleration(self, velocity: Array, dt: float, limit_m_s2: float) -> Array:
        """Rate of change of the setpoint (3,) [m/s^2], smoothed, within the vehicle's limit."""
        last, self._last = self._last, velocity
        if last is None or dt <= 0.0:
            self._acceleration = np.zeros(3)
        else:
            rate = np.clip((velocity - last) / dt, -limit_m_s2, limit_m_s2)
            share = dt / (_SMOOTHING_S + dt)
            self._acceleration = self._acceleration + share * (rate - self._acceleration)
        return np.asarray(self._acceleration)


class GainFit:
    """Judge whether the gains of the scenario fit the vehicle, by its parameters before the flight and by its link."""

    def __init__(self, link: VehicleLink, mavlink: Mavlink, config: AgentConfig) -> None:
        self._link, self._mavlink, self._config = link, mavlink, config
        self.refusal = ""
        """The reason why its velocity loop cannot follow this scenario; empty while nothing says so."""
        self.unfit = ""
        """The reason why the scenario's loop would swing this vehicle by attitudes; empty while nothing says so."""

    def to_velocity_loop(self, response: VelocityResponse) -> str:
        """A line about the gain that fits a response; `refusal` if the scenario has more."""
        if self._link.setpoint == "position_velocity":
            return "warning: position_velocity: gains.formation.kappa_1_s is not compared with the vehicle"
        if self._link.setpoint != "velocity":
            return ""
        lead, kappa = self._mavlink.acceleration_feed_forward, self._config.formation.kappa
        most = largest_kappa_1_s(response, lead)
        if kappa > most + 1e-9:
            remedy = "" if lead else ", or mavlink.acceleration_feed_forward: true"
            self.refusal = (
                f"gains.formation.kappa_1_s = {kappa:g}: the vehicle's velocity loop would swing: "
                f"expected at most {most:.1f}{remedy}"
            )
        return f"gains.formation.kappa_1_s up to {most:.1f} fits its velocity loop"

    def to_delay(self, delay_s: float, *, led: bool) -> str:
        """A line with the gain that fits a delay from a state to its force; `unfit` if the scenario has more.

        `led`: whether the vehicle flies the rates of roll and pitch that are sent beside an attitude.
        """
        tilt_lag_s = _TILT_LAG_S if self._link.tilt_lag_s is None else self._link.tilt_lag_s
        config = self._config
        most = largest_force_kappa_1_s(config, delay_s, tilt_lag_s, led=led)
        kappa, pole = config.controller.force.kappa, config.controller.observer_bandwidth
        swings = f"the vehicle would swing, {delay_s:.3f} s from a state to its force: expected"
        if most == 0.0:  # then the observer is too fast, or the planner
            self.unfit = (
                f"gains.observer.bandwidth_1_s = {pole:g}, gains.formation.kappa_1_s = {config.formation.kappa:g}: "
                f"{swings} less, or a faster link"
            )
        elif kappa > most + 1e-9:
            self.unfit = (
                f"gains.force.kappa_1_s = {kappa:g}: {swings} at most {most:.1f}, or a faster link"
            )
        return (
            f"gains.force.kappa_1_s up to {most:.1f} fits {delay_s:.3f} s from a state to its force"
        )


class StreamInput(NamedTuple):
    """The inputs of one tick of the stream."""

    stream: Stream  # what the procedure requests
    now_s: float  # steady clock
    odometry: Array  # newest state (13,), world frame
    offset: Array  # world position of the vehicle's local origin (3,) [m]
    reply: SetpointReply | None  # newest setpoint of the UAV process
    armed: bool  # a disarmed vehicle is held where it stands, wherever that is
    flight_s: float  # time since the first epoch [s], negative before it


class SetpointStream:
    """Turns the procedure's and the controller's requests into messages; the world frame ends here."""

    def __init__(self, link: VehicleLink, mavlink: Mavlink, config: AgentConfig) -> None:
        self._autopilot = autopilot = AUTOPILOTS[link.autopilot]
        self._link, self._mavlink = link, mavlink
        self.fit = GainFit(link, mavlink, config)
        self.response: VelocityResponse | None = None
        """The response of the vehicle to velocities, by its parameters; None before they are read, or without them."""
        self._yaw_gain = config.controller.attitude_gain[1]
        self.guard = SetpointGuard(mavlink.geofence, allowed(mavlink.limits, limits({})))
        self._messages = SetpointMessages(autopilot, link.sysid)
        self.attitude = AttitudeTargets(config.controller, mavlink.hover_thrust)
        self.attitude.thrust_test.over = not autopilot.attitude_only
        heading = unwrap(reference)(config.trajectory, 0.0).yaw  # without the compiler
        self.climb = _Climb(mavlink.takeoff_height_m, heading)
        self._integral = _VelocityIntegral()
        self.drag = DragEstimator(config.controller.gravity)
        self.following = FollowingEstimator()
        self.lead: VelocityLead | None = None
        """For a vehicle whose response is known; without it the velocity is sent as it is wanted."""
        self.latency = Latency()
        self.ages = Latency()
        """Of the states that the controller's newest setpoints answer, when targets are sent."""
        self._stream = Stream.NONE
        self._hold: _HoldPoint | None = None
        self.layer_m = 0.0
        """Height [m] in the world at which this vehicle holds apart from the others."""
        self._last_s = float("inf")

    def sends_thrust(self, stream: Stream) -> bool:
        """True if the setpoints of a stream have a thrust."""
        if stream is Stream.PLANNER:
            return self._link.setpoint == "attitude"
        return self._autopilot.attitude_only and stream is not Stream.NONE

    def learn(self, stream: Stream, now_s: float, sampled_s: float, odometry: Array) -> str:
        """From a state (13,) of the flying vehicle: what thrust and drag do to it; a line when there is news."""
        if stream is Stream.PLANNER:
            self.drag.on_odometry(now_s, odometry)
        if not self.sends_thrust(stream):
            return ""
        news = self.attitude.on_odometry(now_s, sampled_s, odometry)
        found = self.attitude.thrust_test.found
        return news if not news or found is None else f"{news}; {self.fit_to_link(found.delay_s)}"

    def take_parameters(self, values: Mapping[str, float]) -> None:
        """Lower the limits to those of the vehicle, and take over what else its parameters say of it."""
        self.guard.limits = allowed(self._mavlink.limits, limits(values))
        known = values.get("MPC_THR_HOVER", values.get("MOT_THST_HOVER"))
        self.attitude.hover.value = known or self._mavlink.hover_thrust
        response = velocity_response(self._autopilot, values)
        if response is not None:
            link = self._link
            self.response = response.measured(link.velocity_loop_1_s, link.tilt_lag_s)

    def fit_to_vehicle(self) -> str:
        """Send velocities so that this vehicle flies what the planner wants, as far as that goes; a line about it."""
        if self.response is None:
            return ""
        if self._mavlink.acceleration_feed_forward:
            self.lead = VelocityLead(self.response, 1.0 / self._mavlink.rate_hz)
        return self.fit.to_velocity_loop(self.response)

    def fit_to_link(self, thrust_delay_s: float = 0.0) -> str:
        """Compare the gains with the link, and a delay from target to force; a line about it.

        Autopilots that close loops of their own besides take no rates of roll and pitch beside an attitude.
        """
        waits_s = 0.5 / self._mavlink.rate_hz  # for the next target, on average
        delay_s = self.ages.percentile_s(50) + waits_s + thrust_delay_s
        return self.fit.to_delay(delay_s, led=self._autopilot.attitude_only)

    def unprepared(self, odometry: Array) -> str:
        """The task that the vehicle has left before the formation; empty when none."""
        if not self.climb.heading_reached(odometry):
            return "turning to the formation's heading"
        return "" if self.attitude.thrust_test.over else "showing what its thrust does"

    def message(self, tick: StreamInput) -> Any:
        """The setpoint of this tick; None when none may be sent."""
        dt = min(max(tick.now_s - self._last_s, 0.0), _MAX_STEP_S)
        self._last_s = tick.now_s
        if tick.stream is not self._stream or not tick.armed:
            self._restart(tick)
        if tick.reply is not None:
            self.ages.add(tick.now_s - tick.reply.odometry.sampled_s)
        if tick.stream is Stream.PLANNER and tick.reply is not None:
            self.latency.add(tick.now_s - tick.reply.odometry.arrived_s)
            return self._follow(tick, tick.reply, dt)
        target = self._hold
        if tick.stream is Stream.CLIMB:
            target = self.climb.target(tick.odometry, dt, self.guard.limits.up_m_s)
        elif tick.stream is Stream.APART and target is not None:
            # Towards the height of the layer, at a walking pace, and never far ahead of the vehicle.
            height_m, step_m = tick.odometry[2], dt * min(_CLIMB_M_S, self.guard.limits.down_m_s)
            ahead = min(max(self.layer_m, height_m - _AHEAD_M), height_m + _AHEAD_M)
            target.position[2] += min(max(ahead - target.position[2], -step_m), step_m)
        elif tick.stream is not Stream.HOLD:
            return None
        return None if target is None else self._hold_at(target, tick, dt)

    def _restart(self, tick: StreamInput) -> None:
        self._stream = tick.stream
        self._hold = _HoldPoint(tick.odometry)
        self._integral.restart()
        if self.lead is not None:
            self.lead.restart()
        self.attitude.restart(tick.armed)
        if not tick.armed:
            self.climb.reset(float(tick.odometry[2]))

    def _hold_at(self, target: _HoldPoint, tick: StreamInput, dt: float) -> Any:
        now_s, position = tick.now_s, self.guard.position(target.position)
        if not self._autopilot.attitude_only:
            local = position - tick.offset
            return self._messages.position_target(now_s, target.yaw, position=local)
        if not tick.armed:  # the rotors must not turn before the vehicle is meant to lift
            level = AttitudeTarget(tick.odometry[3:7], np.zeros(3), 0.0)
            return self._messages.attitude_target(now_s, level)
        attitude = self.attitude.for_point(
            position, target.yaw, tick.odometry, now_s, dt, self.guard.limits.tilt_rad
        )
        return self._messages.attitude_target(now_s, attitude)

    def _follow(self, tick: StreamInput, reply: SetpointReply, dt: float) -> Any:
        answered, guard = reply.odometry, self.guard
        moving = np.array(velocity_enu(tick.odometry))
        if self._link.setpoint == "attitude" and guard.outside(
            guard.ahead(tick.odometry[0:3], moving)
        ):
            # A wrench cannot be cut down to the fence: the vehicle is held at the nearest place inside.
            self._hold = _HoldPoint(tick.odometry)
            return self._hold_at(self._hold, tick, dt)
        if self._link.setpoint == "attitude":
            attitude = self.attitude.for_wrench(
                reply.values,
                answered.values,
                answered.sampled_s,
                tick.flight_s,
                guard.limits.tilt_rad,
            )
            return self._messages.attitude_target(tick.now_s, attitude)
        velocity = guard.velocity(reply.values[0:3], tick.odometry[0:3], moving)
        self.following.add(tick.now_s, velocity, moving)
        acceleration = position = None
        if self._mavlink.acceleration_feed_forward:
            limit = guard.limits.acceleration_m_s2
            acceleration = self._integral.acceleration(velocity, dt, limit)
            if self.lead is not None and self._link.setpoint == "velocity":
                level, push = self.lead.setpoint(velocity[0:2], self.drag.value)
                length = math.hypot(*push)
                acceleration[0:2] = push * min(1.0, limit / length) if length > 0.0 else 0.0
                if self.response is not None and self.response.shaping_1_s is not None:
                    # The shaping makes the same of it: k (u - v) + a is k (u + a / k - v).
                    level = level + acceleration[0:2] / self.response.shaping_1_s
                velocity = guard.velocity(np.append(level, velocity[2]), tick.odometry[0:3], moving)
            if self._autopilot.integrates:  # a link that falls silent would leave it accelerating
                acceleration = None
        if self._link.setpoint == "position_velocity":
            target = self._integral.position(velocity, tick.odometry, dt)
            position = guard.position(target) - tick.offset
        return self._messages.position_target(
            tick.now_s,
            reply.desired_yaw(self._yaw_gain),
            position=position,
            velocity=velocity,
            acceleration=acceleration,
        )
