"""The force of a normalised thrust: force = weight (thrust / thrust at hover)^slope, after a delay.

The thrust at hover is followed in the whole flight, so a battery that sags costs no height. Slope and delay are found
once, before the formation: `ThrustTest` adds a known pattern to the thrust of a vehicle that holds a point.
"""

from __future__ import annotations

import math
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.kinematics import rotation_from_quaternion
from ptnsbc_core.timebase import Clock, loop_gain
from ptnsbc_core.types import AgentConfig, Array, ControllerConfig
from ptnsbc_io.mavlink.setpoints import AttitudeTarget
from ptnsbc_nodes.bridge.setpoint.velocity_lead import MOST_RISE

_LEVEL = 0.5
"""Upward part of the thrust axis; a vehicle tilted farther shows nothing about hovering."""
_LEAST_LIFT = 0.2  # of gravity


class HoverThrust:
    """Normalised thrust at hover: from a parameter, then from what thrust does to the velocity."""

    _MIN_THRUST, _MAX_THRUST = 0.05, 0.95
    _RANGE = 0.5  # the estimate stays within this share of its first value
    _TIME_S = 2.0
    _SPAN_S = 0.2

    def __init__(self, first: float, gravity_m_s2: float) -> None:
        self.value = first
        self.slope = 1.0
        """Relative change of the force per relative change of the thrust [1]."""
        self._bounds = (first * (1.0 - self._RANGE), min(first * (1.0 + self._RANGE), 0.9))
        self._gravity = gravity_m_s2
        self._since: tuple[float, float] | None = None  # (time, upward velocity)
        self._sum = 0.0
        self._count = 0

    def on_sent(self, thrust: float) -> None:
        """Count a thrust that was sent."""
        self._sum += thrust
        self._count += 1

    def on_odometry(self, now_s: float, odometry: Array) -> None:
        """Learn from every new odometry (13,) while the bridge sends the thrust."""
        climb, level = _upwards(odometry)
        if self._since is None or now_s - self._since[0] > 2 * self._SPAN_S:
            return self._restart(now_s, climb)
        span = now_s - self._since[0]
        if span < self._SPAN_S or not self._count:
            return None
        lift = ((climb - self._since[1]) / span + self._gravity) / max(level, _LEVEL)
        if lift > _LEAST_LIFT * self._gravity and level > _LEVEL:
            measured = self._sum / self._count * (self._gravity / lift) ** (1.0 / self.slope)
            share = span / (self._TIME_S + span)
            self.value += share * (measured - self.value)
            self.value = min(max(self.value, self._bounds[0]), self._bounds[1])
        return self._restart(now_s, climb)

    def _restart(self, now_s: float, climb: float) -> None:
        self._since = (now_s, climb)
        self._sum, self._count = 0.0, 0

    def normalised(self, force_per_kg: float, nudge: float = 0.0) -> float:
        """Thrust 0 to 1 for a specific force along body z [m/s^2], times exp(`nudge`)."""
        share = max(force_per_kg, 0.0) / self._gravity
        thrust = self.value * share ** (1.0 / self.slope) * math.exp(nudge)
        return min(max(thrust, self._MIN_THRUST), self._MAX_THRUST)


class ThrustResponse(NamedTuple):
    """The findings of `ThrustTest`."""

    slope: float  # relative change of the force per relative change of the thrust
    delay_s: float  # from a target that is sent to its force, the motors' lag included


class ThrustTest:
    """Adds a pattern to the thrust, and finds from how the vehicle moves what thrust does to it.

    The loop that holds the point answers noise and gusts with thrust, so a regression of the acceleration on the thrust
    is biased. The pattern is independent of both: with it k seconds earlier, the covariances of the acceleration are
    those of the thrust, delayed, times the slope, whatever the loop does. Slope, delay and lag of the motors are their
    least squares (instrumental variables, Söderström and Stoica 1983). Acceleration and thrust are logarithms.

    A symbol of the pattern is + - - + or its opposite: it leaves neither speed nor height.
    """

    _SIZE = 0.06  # of the logarithm of the thrust
    _PART_S, _PARTS = 0.15, np.array((1.0, -1.0, -1.0, 1.0))
    _PATTERN = np.kron(np.random.default_rng(6).choice((-1.0, 1.0), 18), _PARTS)
    _PADDED = np.pad(_PATTERN, 1)  # zero before and after
    _GAP_S = 0.25
    _TAIL_S = 0.8
    _LAGS_S = np.arange(-0.2, _TAIL_S, 0.02)  # of the pattern
    _DELAYS_S = np.arange(0.0, 0.4, 0.005)
    _MOTORS_S = (0.0, 0.01, 0.02, 0.03, 0.04, 0.06, 0.08)
    _FINE_S = 0.005
    _LEAST_EXPLAINED = 0.6  # share of the covariances of acceleration and pattern
    _SLOPES = (0.5, 3.0)
    _PATIENCE = 3.0  # lengths

    def __init__(self, gravity_m_s2: float) -> None:
        self.over = False
        self.found: ThrustResponse | None = None
        """None before the test is over, and when the vehicle did not show it."""
        self._gravity = gravity_m_s2
        self._sent: list[tuple[float, float]] = []  # time, logarithm of the thrust
        self._states: list[tuple[float, float, float]] = []  # time, upward velocity, level
        self._first_s, self._flew_s = math.inf, -math.inf

    @property
    def length_s(self) -> float:
        """Duration of the test [s]."""
        return len(self._PATTERN) * self._PART_S + self._TAIL_S

    def nudge(self, now_s: float) -> float:
        """The pattern now, to be added to the logarithm of the thrust; zero on the ground and when the test is over."""
        if not self._runs(now_s):
            return 0.0
        self._forget_before_gap(now_s)
        since_s = now_s - self._sent[0][0] if self._sent else 0.0
        return self._SIZE * float(self._pattern(np.array([since_s]))[0])

    def on_sent(self, now_s: float, thrust: float) -> None:
        """Take the thrust that was sent."""
        if self._runs(now_s):
            self._sent.append((now_s, math.log(thrust)))

    def on_odometry(self, now_s: float, sampled_s: float, odometry: Array) -> bool:
        """Take the odometry (13,) of a flying vehicle, sampled at `sampled_s`; returns whether the test is over."""
        if self.over:
            return True
        self._forget_before_gap(now_s)
        self._flew_s = now_s
        self._first_s = min(self._first_s, now_s)
        if not self._states or sampled_s > self._states[-1][0]:
            self._states.append((sampled_s, *_upwards(odometry)))
        if self._sent and sampled_s - self._sent[0][0] >= self.length_s:
            self.over, self.found = True, self._response()
        self.over = self.over or now_s - self._first_s > self._PATIENCE * self.length_s
        return self.over

    def _forget_before_gap(self, now_s: float) -> None:
        """Without states nothing is sent: so a gap of either shows in what was sent."""
        if self._sent and now_s - self._sent[-1][0] > self._GAP_S:
            self._sent, self._states = [], []

    def _runs(self, now_s: float) -> bool:
        return not self.over and now_s - self._flew_s <= self._GAP_S

    def _pattern(self, since_s: Array) -> Array:
        """The pattern (N,) at times (N,) since it began [s]; zero before and after."""
        part = np.floor(since_s / self._PART_S).astype(int) + 1
        return np.asarray(self._PADDED[np.clip(part, 0, len(self._PADDED) - 1)])

    def _response(self) -> ThrustResponse | None:
        sent, states = np.array(self._sent), np.array(self._states)
        begin = sent[0, 0]
        ends = states[states[:, 0] > begin + self._DELAYS_S[-1]]
        times, level = ends[:, 0], np.maximum(ends[:, 2], _LEVEL)[1:]
        lift = (np.diff(ends[:, 1]) / np.diff(times) / self._gravity + 1.0) / level
        middles = 0.5 * (times[1:] + times[:-1]) - begin
        pattern = self._pattern(middles - self._LAGS_S[:, None])  # (K, N)
        line, _ = np.linalg.qr(np.vander(middles, 2))
        pattern = pattern - pattern @ line @ line.T  # sees no trend of what it is multiplied with
        shown = pattern @ np.log(np.maximum(lift, _LEAST_LIFT))  # (K,)
        asked = pattern @ self._thrusts(sent, times)  # (K, M)
        slopes = shown @ asked / np.sum(asked * asked, axis=0)
        left = np.sum((shown[:, None] - slopes * asked) ** 2, axis=0)
        best = int(np.argmin(left))
        motor, delay = divmod(best, len(self._DELAYS_S))
        slope, (low, high) = float(slopes[best]), self._SLOPES
        most_left = (1.0 - self._LEAST_EXPLAINED) * float(shown @ shown)
        if not (low <= slope <= high and left[best] <= most_left):
            return None
        return ThrustResponse(slope, float(self._DELAYS_S[delay]) + self._MOTORS_S[motor])

    def _thrusts(self, sent: Array, times: Array) -> Array:
        """Mean logarithm of the thrust between `times` (N + 1,), behind every lag and delay: (N, M)."""
        step = self._FINE_S
        grid = np.arange(sent[0, 0], times[-1] + step, step)
        held = sent[np.searchsorted(sent[:, 0], grid, side="right") - 1, 1]
        late = times[:, None] - self._DELAYS_S
        means = []
        for motor_s in self._MOTORS_S:
            keep = math.exp(-step / motor_s) if motor_s > 0.0 else 0.0
            whole = np.concatenate(([0.0], np.cumsum(_lagged(held, keep))[:-1])) * step
            means.append(np.diff(np.interp(late, grid, whole), axis=0) / np.diff(times)[:, None])
        return np.concatenate(means, axis=1)


def _lagged(values: Array, keep: float) -> list[float]:
    """Samples (N,) behind a lag of first order, which keeps this share of the last; the first was there before."""
    return [*accumulate(values.tolist(), lambda last, new: keep * last + (1.0 - keep) * new)]


def _upwards(odometry: Array) -> tuple[float, float]:
    """Upward velocity [m/s], and the upward part of the thrust axis, of an odometry (13,)."""
    rotation = rotation_from_quaternion(odometry[3:7])
    return float(rotation[2] @ odometry[7:10]), float(rotation[2, 2])


_AT_LIMIT = 1.0 - 1e-9
_RATE_LOOP_S = 0.04  # part of the lag of the tilt; the motors are in the delay
_STEEPER = 1.12  # error of the slope that is found
_MOST_KAPPA_TENTHS = 100
_ALL_AXES = np.ones(3, dtype=bool)


def _product(first: Array, then: Array) -> Array:
    """Quaternion (4,) x y z w of the turn `first`, and then in its frame `then`."""
    a, b, c, d = first
    return np.array([[d, -c, b, a], [c, d, -a, b], [-b, a, d, c], [-a, -b, -c, d]]) @ then


def _quaternion(turn: Array) -> Array:
    """Quaternion (4,) x y z w of a rotation vector (3,) [rad]."""
    half = 0.5 * math.sqrt(float(turn @ turn))
    return np.append(0.5 * np.sinc(half / math.pi) * turn, math.cos(half))


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
    return limit_tilt(_product(odometry[3:7], _quaternion(turn)), max_tilt_rad)


def unsaturated_axes(wrench: Array, config: ControllerConfig) -> Array:
    """Axes (3,) whose torque is within its limit: only there is `attitude_from_wrench` exact.

    A torque at its limit says "more", not how much. The attitude read from it is a little ahead of the
    vehicle's own attitude, and turns as the vehicle does.
    """
    return np.asarray(np.abs(wrench[3:6]) < _AT_LIMIT * np.array(config.max_torque))


def limit_tilt(quaternion: Array, max_tilt_rad: float) -> Array:
    """The attitude turned straight back until its thrust axis is within the allowed tilt."""
    up = rotation_from_quaternion(quaternion)[:, 2]
    tilt = math.acos(min(max(float(up[2]), -1.0), 1.0))
    level = math.hypot(up[0], up[1])
    if tilt <= max_tilt_rad or level < 1e-9:
        return quaternion
    axis = np.array([-up[1], up[0], 0.0]) / level  # a turn about it increases the tilt
    return _product(_quaternion((max_tilt_rad - tilt) * axis), quaternion)


def attitude_from_force(force_enu: Array, yaw_enu_rad: float) -> Array:
    """Attitude (4,) x y z w whose z axis is along a force (3,) and whose x axis has a heading."""
    up = force_enu / math.sqrt(float(force_enu @ force_enu))
    level = math.hypot(up[0], up[1])
    tilt = math.acos(min(max(float(up[2]), -1.0), 1.0))
    axis = np.zeros(3) if level < 1e-9 else np.array([-up[1], up[0], 0.0]) / level
    heading = _quaternion(np.array([0.0, 0.0, yaw_enu_rad]))
    return _product(_quaternion(tilt * axis), heading)


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

        `known` (3,): axes about which the target is the controller's own; the rate about others is zero. `at_s`: the
        instant that the target belongs to; a target that is not newer changes nothing.
        """
        last, dt = self._last, at_s - self._last_s
        if last is not None and dt <= 0.0:
            return self._rates
        if last is None or dt > self._MAX_GAP_S:
            self._rates = np.zeros(3)
        else:
            turn = _product(last * (-1.0, -1.0, -1.0, 1.0), quaternion)
            sine = math.sqrt(float(turn[0:3] @ turn[0:3]))  # of half the angle
            angle = math.copysign(2.0 * math.atan2(sine, abs(turn[3])), turn[3])  # the shorter way
            measured = angle / (max(sine, 1e-12) * dt) * turn[0:3]
            if np.abs(measured).max() > self._MAX_RAD_S:
                measured = np.zeros(3)  # the target jumped: that is no motion of the target
            smoothed = self._rates + dt / (self.SMOOTHING_S + dt) * (measured - self._rates)
            self._rates = np.where(known & self._known, smoothed, 0.0)
        self._last, self._last_s, self._known = quaternion, at_s, known
        return self._rates


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


def largest_force_kappa_1_s(
    config: AgentConfig, delay_s: float, tilt_lag_s: float, *, led: bool = True
) -> float:
    """Largest gain [1/s] of the velocity loop with which the position loop rises by less than a third, in steps of 0.1.

    `delay_s` is from the state that a target answers to its force, `tilt_lag_s` that of the tilt; `led`: the vehicle
    flies the rates of roll and pitch that are sent with a target.
    It counts a thrust that is 12 % steeper than known, a tilt that is a quarter slower, and every shorter delay. It is
    0 where no gain will do.
    """
    s = 1j * np.geomspace(0.1, 40.0, 200)
    ahead = s / (1.0 + BodyRateEstimator.SMOOTHING_S * s) if led else 0.0 * s
    cases = []
    for share in (0.0, 0.5, 1.0):
        late = np.exp(-share * delay_s * s)
        for slower in (1.0, 1.25):
            rate_s = slower * _RATE_LOOP_S
            tilt_s = max(slower * tilt_lag_s - rate_s, rate_s)
            tilt = (1.0 + tilt_s * ahead) / (1.0 + tilt_s * s * (1.0 + rate_s * s))
            cases.append((late * tilt, False))  # the observer knows the tilt: it sees no lag
        cases += [(late, True), (_STEEPER * late, True)]
    for tenths in range(1, _MOST_KAPPA_TENTHS):
        if max(_rise(config, 0.1 * tenths, *case, s) for case in cases) > MOST_RISE:
            return 0.1 * (tenths - 1)
    return 0.1 * _MOST_KAPPA_TENTHS
