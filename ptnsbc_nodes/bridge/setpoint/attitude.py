"""Attitude targets: quaternion, body rates and thrust, from the controller's wrench or for holding a point.

The controller of ptnsbc_core asks for torques. A flight controller closes the attitude and rate loops
itself and takes an attitude. So the torque is read backwards through the two loops that made it:
rates_d = rates + torque / (inertia G), turn = rates_d / attitude_gain, q_d = q exp(turn).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.timebase import Clock, loop_gain
from ptnsbc_core.types import AgentConfig, Array, ControllerConfig
from ptnsbc_nodes.bridge.setpoint.lead import MOST_RISE
from ptnsbc_nodes.bridge.setpoint.thrust import HoverThrust, ThrustTest

_AT_LIMIT = 1.0 - 1e-9
_RATE_LOOP_S = 0.04  # part of the lag of the tilt; the motors are in the delay
_STEEPER = 1.12  # error of the slope that is found
_MOST_KAPPA_TENTHS = 100
_ALL_AXES = np.ones(3, dtype=bool)
_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])


class AttitudeTarget(NamedTuple):
    """The content of SET_ATTITUDE_TARGET, in ENU and FLU."""

    quaternion: Array  # (4,) x y z w, FLU to ENU
    rates: Array  # (3,) [rad/s] at which the target itself turns, FLU of the target
    thrust: float  # 0 to 1


def attitude_from_wrench(
    wrench: Array, odometry: Array, flight_s: float, config: ControllerConfig, max_tilt_rad: float
) -> Array:
    """Attitude (4,) x y z w that a wrench (6,) asks for.

    `odometry` (13,) is the one it was computed from, `flight_s` the time since the first epoch.
    """
    time = max(flight_s, 0.0)
    gain = loop_gain(config.torque, Clock(time, time, 0.01))
    rates = odometry[10:13] + wrench[3:6] / (np.array(config.nominal.inertia) * gain)
    tilt, yaw = config.attitude_gain
    turn = rates / np.array([tilt, tilt, yaw])
    desired = quaternion_product(odometry[3:7], quaternion_exp(turn))
    return limit_tilt(desired, max_tilt_rad)


def unsaturated_axes(wrench: Array, config: ControllerConfig) -> Array:
    """Axes (3,) whose torque is within its limit: only there is `attitude_from_wrench` exact.

    A torque at its limit says "more", not how much. The attitude read from it is a little ahead of the
    vehicle's own attitude, and turns as the vehicle does.
    """
    return np.asarray(np.abs(wrench[3:6]) < _AT_LIMIT * np.array(config.max_torque))


def quaternion_product(a: Array, b: Array) -> Array:
    """Quaternion a b, both x y z w."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return np.array(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    )


def quaternion_exp(turn: Array) -> Array:
    """Quaternion (4,) x y z w of a rotation vector (3,) [rad]."""
    angle = math.sqrt(float(turn @ turn))
    scale = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    return np.array([*(scale * turn), math.cos(0.5 * angle)])


def limit_tilt(quaternion: Array, max_tilt_rad: float) -> Array:
    """The attitude turned straight back until its thrust axis is within the allowed tilt."""
    up = rotation_from_quaternion(quaternion)[:, 2]
    tilt = math.acos(min(max(float(up[2]), -1.0), 1.0))
    level = math.hypot(up[0], up[1])
    if tilt <= max_tilt_rad or level < 1e-9:
        return quaternion
    axis = np.array([-up[1], up[0], 0.0]) / level  # a turn about it increases the tilt
    back = quaternion_product(quaternion_exp(-(tilt - max_tilt_rad) * axis), quaternion)
    return back / math.sqrt(float(back @ back))


def attitude_from_force(force_enu: Array, yaw_enu_rad: float) -> Array:
    """Attitude (4,) x y z w whose z axis is along a force (3,) and whose x axis has a heading."""
    up = force_enu / math.sqrt(float(force_enu @ force_enu))
    level = math.hypot(up[0], up[1])
    tilt = math.acos(min(max(float(up[2]), -1.0), 1.0))
    axis = np.zeros(3) if level < 1e-9 else np.array([-up[1], up[0], 0.0]) / level
    heading = quaternion_exp(np.array([0.0, 0.0, yaw_enu_rad]))
    return quaternion_product(quaternion_exp(tilt * axis), heading)


class PointHold:
    """Acceleration towards a point: proportional, damped, with a slow integral against the wind.

    It is for vehicles that take attitude targets only, before the formation begins and when it fails.
    """

    _STIFFNESS_1_S2 = 1.4
    _DAMPING_1_S = 2.2
    _INTEGRAL_1_S3 = 0.3
    _MAX_M_S2 = 2.5
    _MAX_INTEGRAL_M_S2 = 2.0

    def __init__(self, gravity_m_s2: float) -> None:
        self._gravity = gravity_m_s2
        self._integral = np.zeros(3)

    def force_per_kg(self, odometry: Array, position_enu: Array, dt: float) -> Array:
        """Specific force (3,) [m/s^2, ENU] that brings the vehicle to `position_enu` (3,) [m]."""
        error = position_enu - odometry[0:3]
        velocity = rotation_from_quaternion(odometry[3:7]) @ odometry[7:10]
        limit = self._MAX_INTEGRAL_M_S2
        near = np.clip(error, -0.5, 0.5)
        self._integral = np.clip(self._integral + dt * self._INTEGRAL_1_S3 * near, -limit, limit)
        force = self._STIFFNESS_1_S2 * error - self._DAMPING_1_S * velocity + self._integral
        force = np.clip(force, -self._MAX_M_S2, self._MAX_M_S2)
        force[2] += self._gravity
        return np.asarray(force)


class BodyRateEstimator:
    """Body rates (3,) [rad/s, FLU of the target] of a sequence of attitude targets, smoothed.

    They are a feed-forward for the vehicle's attitude loop: the vehicle adds them to the rates with which
    it turns towards the target. So they must be the target's own rates. A target that was computed from the
    measured attitude and moves with it would feed the vehicle's own turning back to it.
    """

    SMOOTHING_S = 0.15
    _MAX_RAD_S = 2.0
    _MAX_GAP_S = 0.2

    def __init__(self) -> None:
        self._rates = np.zeros(3)
        self._last: Array | None = None
        self._last_s = 0.0
        self._known = np.zeros(3, dtype=bool)

    def update(self, quaternion: Array, known: Array, at_s: float) -> Array:
        """The body rates with this target.

        Args:
            quaternion: (4,) x y z w, FLU to ENU.
            known: (3,) axes about which the target is the controller's own; the rate about others is zero.
            at_s: the instant that the target belongs to; a target that is not newer changes nothing.
        """
        last, dt = self._last, at_s - self._last_s
        if last is not None and dt <= 0.0:
            return self._rates
        if last is None or dt > self._MAX_GAP_S:
            self._rates = np.zeros(3)
        else:
            step = quaternion_product(last * _CONJUGATE, quaternion)
            measured = 2.0 * np.copysign(1.0, step[3]) * step[0:3] / dt
            if np.abs(measured).max() > self._MAX_RAD_S:
                measured = np.zeros(3)  # the target jumped: that is no motion of the target
            smoothed = self._rates + dt / (self.SMOOTHING_S + dt) * (measured - self._rates)
            self._rates = np.where(known & self._known, smoothed, 0.0)
        self._last, self._last_s, self._known = quaternion, at_s, known
        return self._rates


def vertical_rate(rates: Array, quaternion: Array) -> float:
    """The part about the vertical of body rates (3,) [rad/s, FLU] of a target (4,), positive to the left."""
    return float(rotation_from_quaternion(quaternion)[2] @ rates)


class AttitudeTargets:
    """Complete attitude targets for one vehicle: their body rates, and the thrust that its hover thrust asks for."""

    def __init__(self, config: ControllerConfig, hover_thrust: float) -> None:
        self._config = config
        self.hover = HoverThrust(hover_thrust, config.gravity)
        self.thrust_test = ThrustTest(config.gravity)
        self._point_hold = PointHold(config.gravity)
        self._body_rates = BodyRateEstimator()

    def restart(self, armed: bool) -> None:
        """Begin a new sequence of targets; a vehicle on the ground also forgets the wind."""
        self._body_rates = BodyRateEstimator()
        if not armed:
            self._point_hold = PointHold(self._config.gravity)

    def for_wrench(
        self, wrench: Array, odometry: Array, sampled_s: float, flight_s: float, max_tilt_rad: float
    ) -> AttitudeTarget:
        """The target for a wrench (6,) computed from the odometry (13,) sampled at `sampled_s`."""
        quaternion = attitude_from_wrench(wrench, odometry, flight_s, self._config, max_tilt_rad)
        known = unsaturated_axes(wrench, self._config)
        rates = self._body_rates.update(quaternion, known, sampled_s)
        return self._with_thrust(quaternion, rates, wrench[2] / self._config.nominal[0])

    def for_point(
        self,
        position: Array,
        yaw: float,
        odometry: Array,
        now_s: float,
        dt: float,
        max_tilt_rad: float,
    ) -> AttitudeTarget:
        """The target that holds a point (3,) [m, ENU] with a heading."""
        force = self._point_hold.force_per_kg(odometry, position, dt)
        quaternion = limit_tilt(attitude_from_force(force, yaw), max_tilt_rad)
        along = float(force @ rotation_from_quaternion(odometry[3:7])[:, 2])
        rates = self._body_rates.update(quaternion, _ALL_AXES, now_s)
        nudge = self.thrust_test.nudge(now_s)
        target = self._with_thrust(quaternion, rates, along, nudge)
        self.thrust_test.on_sent(now_s, target.thrust)
        return target

    def on_odometry(self, now_s: float, sampled_s: float, odometry: Array) -> str:
        """Learn from every odometry (13,) of a flying vehicle whose thrust the bridge sends; a line with news."""
        self.hover.on_odometry(now_s, odometry)
        test = self.thrust_test
        if test.over or not test.on_odometry(now_s, sampled_s, odometry):
            return ""
        if test.found is None:
            return "warning: the vehicle did not show what thrust does: its force is taken as proportional"
        self.hover.slope = test.found.slope
        return (
            f"thrust: {self.hover.value:.2f} at hover, the force grows with its power of {test.found.slope:.2f}, "
            f"{test.found.delay_s:.2f} s after the target"
        )

    def _with_thrust(
        self, quaternion: Array, rates: Array, force_per_kg: float, nudge: float = 0.0
    ) -> AttitudeTarget:
        thrust = self.hover.normalised(force_per_kg, nudge)
        self.hover.on_sent(thrust)
        return AttitudeTarget(quaternion, rates, thrust)


class AttitudeResponse(NamedTuple):
    """Lateness of a vehicle behind an attitude target."""

    delay_s: float  # from the state that a target answers to its force
    tilt_lag_s: float  # of the tilt behind the target
    led: bool = (
        True  # whether the vehicle flies the rates of roll and pitch that are sent with a target
    )


def _rise(config: AgentConfig, kappa_1_s: float, flown: Any, observed: bool, s: Any) -> float:
    """Largest rise of a position loop; `flown`: acceleration per wanted one at the complex frequencies `s` (K,)."""
    force, pole = config.controller.force, config.controller.observer_bandwidth if observed else 0.0
    bound = config.controller.bound_cap[0] / config.controller.boundary[0]
    gain = force.scale * kappa_1_s + bound
    low_pass = config.filter.bandwidth / (s + config.filter.bandwidth)
    planner = config.formation.scale * config.formation.kappa * low_pass
    # The observer sees velocity and wanted acceleration, and feeds back what is missing between them.
    seen = (3.0 * pole**2 * s + pole**3) / (s + pole) ** 3
    forward = flown / s * (s + gain) * planner / s / (1.0 - seen)
    loop = flown / s * (gain + seen * s) / (1.0 - seen) + forward
    return float(np.abs(forward / (1.0 + loop)).max())


def largest_force_kappa_1_s(config: AgentConfig, response: AttitudeResponse) -> float:
    """Largest gain [1/s] of the velocity loop with which the position loop rises by less than a third, in steps of 0.1.

    It counts a thrust that is 12 % steeper than known, a tilt that is a quarter slower, and every shorter delay. It is
    0 where no gain will do.
    """
    s = 1j * np.geomspace(0.1, 40.0, 200)
    ahead = s / (1.0 + BodyRateEstimator.SMOOTHING_S * s) if response.led else 0.0 * s
    cases = []
    for share in (0.0, 0.5, 1.0):
        late = np.exp(-share * response.delay_s * s)
        for slower in (1.0, 1.25):
            rate_s = slower * _RATE_LOOP_S
            tilt_s = max(slower * response.tilt_lag_s - rate_s, rate_s)
            tilt = (1.0 + tilt_s * ahead) / (1.0 + tilt_s * s * (1.0 + rate_s * s))
            cases.append((late * tilt, False))  # the observer knows the tilt: it sees no lag
        cases += [(late, True), (_STEEPER * late, True)]
    for tenths in range(1, _MOST_KAPPA_TENTHS):
        if max(_rise(config, 0.1 * tenths, *case, s) for case in cases) > MOST_RISE:
            return 0.1 * (tenths - 1)
    return 0.1 * _MOST_KAPPA_TENTHS
