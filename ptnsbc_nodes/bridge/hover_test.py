"""A hover test of one vehicle: take-off, sinusoids within a box, landing, and the settings that fit. No ROS in here.

Everything that keeps a flight safe is the bridge's own: arming, fence, battery, pilot, failsafe, silence. The test only
takes the place of the UAV process. It ends, and the vehicle lands, when it has what it needs, or leaves its box.
`ptnsbc stop` reaches its process as it reaches a bridge of this host, and knows how to reach the vehicle past it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.kinematics import velocity_enu
from ptnsbc_core.timebase import Clock, h, loop_gain, plan_duration
from ptnsbc_core.types import Array, LoopGain
from ptnsbc_io.mavlink.autopilots import AUTOPILOTS, VelocityResponse
from ptnsbc_io.mavlink.link import MavlinkLink
from ptnsbc_io.wire import HeaderFields, VelocityTemplate
from ptnsbc_nodes.bridge.bridge import Bridge, open_link
from ptnsbc_nodes.bridge.ports import BridgePorts
from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.bridge.setpoint.velocity_lead import (
    PLANNER_DELAY_S,
    flown_per_wanted,
    inverse,
    largest_kappa_1_s,
)
from ptnsbc_nodes.bridge.status import OrderDesk
from ptnsbc_nodes.comm.legs import FIRST_LEG
from ptnsbc_nodes.emergency import LAND, Order, latched, runtime_folder
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.signals import StopRequest
from ptnsbc_sim.scenario import Scenario, agent_config, scenario_from_text
from ptnsbc_sim.scenario.approach.deadline import limits_left, longest_need, start_errors

SETTLE_S = 4.0
# [Hz], and periods; the first period of each is not evaluated
_TONES = ((0.1, 3), (0.25, 4), (0.5, 6))
_MOST_M_S, _LEAST_M_S = 0.5, 0.1
_SHARE = 0.6  # of half the box, for the motion itself; the rest is for drift
_HOLD_1_S, _HOLD_M_S = 0.2, 0.3  # how the middle of the box is held meanwhile
_LEAST_SAMPLES = 40
_NOISE = 0.5  # largest part of the velocity that is not of the tone, as a share of the tone


class TuneError(PtnsbcError):
    """A hover test that cannot be flown, or shows nothing."""


class Tone(NamedTuple):
    """One sinusoid of the test."""

    hertz: float
    amplitude_m_s: float
    begin_s: float  # since the start of the test
    end_s: float


class FrequencyPoint(NamedTuple):
    """The response at one frequency: flown per sent velocity."""

    hertz: float
    response: complex

    @property
    def gain(self) -> float:
        """Ratio of the amplitudes [1]."""
        return abs(self.response)

    @property
    def lag_s(self) -> float:
        """Lag [s], within half a period."""
        return -float(np.angle(self.response)) / (2.0 * math.pi * self.hertz)


class Excitation:
    """The test as a function of time and place."""

    def __init__(self, box_m: float) -> None:
        """`box_m`: side of the box around the place where the test begins [m].

        Raises:
            TuneError: the box is too small for a motion that shows something.
        """
        self.box_m, self.end_s = box_m, SETTLE_S
        self.tones: list[Tone] = []
        for hertz, periods in _TONES:
            room_m_s = _SHARE * 0.5 * box_m * 2.0 * math.pi * hertz
            begin_s, self.end_s = self.end_s, self.end_s + periods / hertz
            self.tones.append(Tone(hertz, min(_MOST_M_S, room_m_s), begin_s, self.end_s))
        slowest = self.tones[0]
        if slowest.amplitude_m_s < _LEAST_M_S:
            least_m = 2.0 * _LEAST_M_S / (_SHARE * 2.0 * math.pi * slowest.hertz)
            raise TuneError(
                f"--box {box_m:g}: expected at least {math.ceil(10 * least_m) / 10:g} m"
            )

    def wanted(self, t: float, away: Array) -> Array:
        """Velocity (3,) [m/s, ENU] at `t` [s] since the start, `away` (3,) [m] from the middle of the box."""
        back = np.clip(-_HOLD_1_S * away, -_HOLD_M_S, _HOLD_M_S)
        for tone in self.tones:
            if tone.begin_s <= t < tone.end_s:
                phase = 2.0 * math.pi * tone.hertz * (t - tone.begin_s)
                back[0] += tone.amplitude_m_s * math.cos(phase)
        return np.asarray(back)

    def left(self, away: Array) -> bool:
        """True if a place `away` (3,) [m] from the middle is outside of the box."""
        return bool(np.abs(away).max() > 0.5 * self.box_m)

    def points(self, sent: Array, flown: Array) -> list[FrequencyPoint]:
        """The response at each frequency, to `sent` (N, 2): time since the start [s] and velocity along x [m/s].

        `flown` (M, 2) has the same of each state of the vehicle.

        Raises:
            TuneError: the vehicle moved too much by itself.
        """
        points = []
        for tone in self.tones:
            (asked, _), (flew, rest_m_s) = _phasor(tone, sent), _phasor(tone, flown)
            if rest_m_s > _NOISE * abs(flew):
                raise TuneError(
                    f"at {tone.hertz:g} Hz the vehicle flew {abs(flew):.2f} m/s, and {rest_m_s:.2f} m/s that were not "
                    f"asked for: expected at most {_NOISE:.0%}; fly in less wind, or with a larger --box"
                )
            points.append(FrequencyPoint(tone.hertz, flew / asked))
        return points


def _phasor(tone: Tone, rows: Array) -> tuple[complex, float]:
    """Least squares of a sinusoid beside a constant and a drift; and the root of the mean square of what is left."""
    # The vehicle swings in within the first period.
    rows = rows[(rows[:, 0] >= tone.begin_s + 1.0 / tone.hertz) & (rows[:, 0] < tone.end_s)]
    if len(rows) < _LEAST_SAMPLES:
        raise TuneError(
            f"{len(rows)} samples at {tone.hertz:g} Hz: expected at least {_LEAST_SAMPLES}; see the link to the vehicle"
        )
    t = rows[:, 0]
    phase = 2.0 * math.pi * tone.hertz * t
    waves = np.stack((np.cos(phase), np.sin(phase), np.ones_like(t), t - t.mean()), axis=1)
    parts, *_ = np.linalg.lstsq(waves, rows[:, 1], rcond=None)
    rest_m_s = math.sqrt(float(np.mean((rows[:, 1] - waves @ parts) ** 2)))
    return complex(parts[0], -parts[1]), rest_m_s


AGREES = 0.1
"""The model of the vehicle must be so near to each measured response."""
_LEAST_KAPPA_1_S = 0.3
_GAINS, _LAGS, _DRAG_1_S = (0.3, 3.0), (0.2, 4.0), (0.0, 2.0)  # shares of the known ones
_STEP_S, _MOST_S = 0.02, 80.0
_FOR_LAG = 0.5  # of the tolerance; the rest is for noise


class Identified(NamedTuple):
    """The vehicle as the hover test found it."""

    response: VelocityResponse
    drag_1_s: float
    delay_s: float  # of link and setpoint period, one way
    points: Sequence[FrequencyPoint]

    def expected(self, hertz: float) -> FrequencyPoint:
        """The response of the model at a frequency."""
        s = 2j * math.pi * hertz
        found = flown_per_wanted(self.response, None, self.drag_1_s, s) * np.exp(-self.delay_s * s)
        return FrequencyPoint(hertz, complex(found))

    @property
    def error(self) -> float:
        """Largest relative difference between model and measurement."""
        return max(
            abs(one.response / self.expected(one.hertz).response - 1.0) for one in self.points
        )


def identified(
    response: VelocityResponse, points: Sequence[FrequencyPoint], delay_s: float
) -> Identified:
    """Gain of the loop, lag of the tilt and drag with which a vehicle of these parameters shows these responses.

    `response` is its velocity loop by its parameters, `delay_s` the known delay between setpoint and vehicle.

    Raises:
        TuneError: no such numbers explain what was measured.
    """

    def made(x: Array) -> Identified:
        gain, lag_s, drag_1_s = map(float, x)
        loop = response.measured(gain * response.gain, lag_s * response.tilt_lag_s)
        return Identified(loop, drag_1_s, delay_s, points)

    def differences(x: Array) -> Array:
        one = made(x)
        off = [p.response / one.expected(p.hertz).response - 1.0 for p in points]
        return np.array([part for value in off for part in (value.real, value.imag)])

    bounds = tuple(zip(_GAINS, _LAGS, _DRAG_1_S, strict=True))
    best = made(least_squares(differences, (1.0, 1.0, 0.3), bounds=bounds).x)
    if best.error > AGREES:
        worst = max(points, key=lambda p: abs(p.response / best.expected(p.hertz).response - 1.0))
        model = best.expected(worst.hertz)
        raise TuneError(
            f"at {worst.hertz:g} Hz gain {worst.gain:.2f} and lag {worst.lag_s:.2f} s, its parameters give at best "
            f"{model.gain:.2f} and {model.lag_s:.2f} s: expected within {AGREES:.0%}, the prediction would not fit it; "
            "see its limits of acceleration, jerk and tilt, or fly it with mavlink.acceleration_feed_forward: false"
        )
    return best


class Settings(NamedTuple):
    """The settings with which a scenario flies this vehicle; each is the scenario's own where that fits."""

    kappa_1_s: float
    largest_kappa_1_s: float
    filter_1_s: float
    residual: float
    deadline_s: float
    shortest_deadline_s: float


def settings(scenario: Scenario, vehicle: Identified) -> Settings:
    """The settings with which a scenario, overrides applied, fits the vehicle.

    Raises:
        TuneError: no settings fit.
    """
    own, lead = scenario.gains.formation, scenario.mavlink.acceleration_feed_forward
    most = largest_kappa_1_s(vehicle.response, lead)
    if most < _LEAST_KAPPA_1_S:
        raise TuneError(
            f"gains.formation.kappa_1_s up to {most:.1f} fits this vehicle: expected at least {_LEAST_KAPPA_1_S:g}; "
            "make its velocity loop faster, or set mavlink.acceleration_feed_forward: true"
        )
    left_s = PLANNER_DELAY_S - vehicle.delay_s
    if left_s <= 0.0:
        raise TuneError(
            f"a setpoint takes {1e3 * vehicle.delay_s:.0f} ms to the vehicle: expected less than "
            f"{1e3 * PLANNER_DELAY_S:.0f} ms for link and planner; a faster link, or a higher mavlink.rate_hz"
        )
    kappa, filter_1_s = min(own.kappa_1_s, most), scenario.gains.filter.bandwidth_1_s
    filter_1_s = max(filter_1_s, math.ceil(1.0 / left_s))
    start_m = max(start_errors(scenario).values())
    share = min(_FOR_LAG * scenario.formation.tolerance_m / start_m, 1.0)
    residual = min(own.residual, share)
    loop = agent_config(scenario, scenario.leader.id).formation
    loop = loop._replace(kappa=kappa, residual=residual)
    limits = limits_left(scenario)
    if min(limits) <= 0.0:
        raise TuneError(
            f"{scenario.source}: the leader's motion leaves nothing of the limits: see ptnsbc check"
        )
    least_s = longest_need(scenario, limits).deadline_s
    shortest = _shortest_s(loop, vehicle, share, least_s, lead=lead)
    return Settings(
        kappa, most, filter_1_s, residual, max(float(own.deadline_s), shortest), shortest
    )


def _shortest_s(
    loop: LoopGain, vehicle: Identified, share: float, least_s: float, *, lead: bool
) -> float:
    """Shortest deadline [s], in halves of a second, after which no more than `share` of the start error is left."""
    answer = impulse_response(vehicle, lead=lead)
    halves = math.ceil(2.0 * least_s)
    while 0.5 * halves < 0.5 * _MOST_S:
        deadline_s = 0.5 * halves
        t, left = approach(loop._replace(duration_s=deadline_s), answer)
        if np.abs(left[t >= deadline_s]).max() <= share:
            return deadline_s
        halves += 1
    raise TuneError(
        f"no deadline up to {0.5 * _MOST_S:g} s leaves {share:.1%} of the start error: raise formation.tolerance_m, "
        "or start nearer"
    )


def impulse_response(vehicle: Identified, *, lead: bool) -> Array:
    """Velocity flown [1/s] per pulse of wanted velocity, every 0.02 s: link and planner, prediction, vehicle."""
    count = round(_MOST_S / _STEP_S)
    s = 2j * math.pi * np.fft.rfftfreq(count, _STEP_S)
    s[0] = 1e-6j
    made = inverse(vehicle.response) if lead else None
    through = flown_per_wanted(vehicle.response, made, vehicle.drag_1_s, s) * np.exp(
        -PLANNER_DELAY_S * s
    )
    return np.fft.irfft(through, count)


def approach(loop: LoopGain, answer: Array) -> tuple[Array, Array]:
    """Times [s] and the error, per start error, of a UAV on the planned approach behind this vehicle."""
    count = min(len(answer) // 2, round((loop.duration_s + 10.0) / _STEP_S))
    plan_s, t = plan_duration(loop), _STEP_S * np.arange(count)
    left, wanted, error = np.empty(count), np.zeros(count), 1.0
    for n in range(count):
        left[n] = error
        planned, then = 1.0 - h(t[n] / plan_s), 1.0 - h((t[n] + _STEP_S) / plan_s)
        gain = loop_gain(loop, Clock(t[n], t[n], _STEP_S))
        wanted[n] = (planned - then) / _STEP_S + gain * (error - planned)
        error -= _STEP_S * float(wanted[: n + 1] @ answer[n::-1])
    return np.asarray(t), left


_BEGIN_NS = 500_000_000
_WAIT_S = 0.005


class HoverTest(BridgePorts):
    """One bridge, and the velocities that it flies instead of those of a UAV process."""

    def __init__(
        self,
        scenario: Scenario,
        uav_id: int,
        link: MavlinkLink,
        steady_s: Callable[[], float],
        ros_ns: Callable[[], int],
        log: Callable[[str], None],
        *,
        allow_arming: bool,
        box_m: float,
    ) -> None:
        """Args as of `Bridge`; `box_m`: side of the box around the place above the take-off [m].

        Raises:
            TuneError: the vehicle takes no velocities, or the box is too small.
        """
        settings = scenario.vehicle_link(uav_id)
        if AUTOPILOTS[settings.autopilot].attitude_only or settings.setpoint != "velocity":
            raise TuneError(
                f"mavlink.vehicles.{uav_id}: {settings.autopilot} by {settings.setpoint}: expected setpoint: velocity; "
                "thrust and delay of vehicles that fly by attitude are found in flight (docs/tuning.md)"
            )
        super().__init__(steady_s, ros_ns)
        self._print = log
        self._excitation = Excitation(box_m)
        self._setpoint = VelocityTemplate("map")
        self._period_s = 1.0 / scenario.mavlink.rate_hz
        self.inputs.controller_ready = True
        bare = {"mavlink.acceleration_feed_forward": False}  # the vehicle itself is tested
        self.bridge = Bridge(
            scenario_from_text(scenario.text, bare, source=scenario.source),
            uav_id,
            link,
            self,
            allow_arming,
            alone=True,
        )
        self._middle: Array | None = None  # of the box (3,) [m]
        self._begin_s = 0.0
        self._announced = False
        self._sent: list[tuple[float, float]] = []  # time [s] and velocity along x [m/s]
        self._flown: list[tuple[float, float]] = []  # the same of each state
        self._problem = ""
        self._complete = False

    def log(self, line: str) -> None:
        """A line for the operator."""
        self._print(line)

    @property
    def over(self) -> bool:
        """True if the vehicle has landed, or a pilot has taken over."""
        return self.bridge.procedure.over

    def land(self) -> None:
        """End the test: the vehicle lands."""
        self._end("the operator ended the test")

    def serve(self) -> None:
        """Do what is due now; call it at least at the rate of the setpoints."""
        procedure = self.bridge.procedure
        if not procedure.awaited and not self._announced:
            self._announced = True
            self.inputs.legs.append(HeaderFields(self.ros_ns() + _BEGIN_NS, FIRST_LEG))
        self.bridge.serve()
        flown_s = self.steady_s() - self._begin_s
        if procedure.step is Step.FLY and self._middle is not None:
            if flown_s > self._excitation.end_s and not self._complete:
                self._complete = True
                self.log("hover test: all sinusoids flown, landing")
                self.inputs.take(Order(LAND))
        elif self._middle is not None and not self._complete and not self._problem:
            fault = procedure.fault or "the flight ended"
            self._end(f"{procedure.step.value}: {fault}")

    def odom(self, stamp_ns: int, odometry: Array) -> None:
        """Answer a state with the velocity of now, as a UAV process does."""
        now_s, velocity = self.steady_s(), np.zeros(3)
        if self.bridge.procedure.step is Step.FLY and not (self._complete or self._problem):
            if self._middle is None:
                self._middle, self._begin_s = odometry[0:3].copy(), now_s
                self.log(
                    f"hover test: {self._excitation.end_s:.0f} s within "
                    f"{self._excitation.box_m:g} m around {self.bridge.placement.text}"
                )
            away = odometry[0:3] - self._middle
            if self._excitation.left(away):
                self._end(
                    f"the vehicle left its box of {self._excitation.box_m:g} m at {self.bridge.placement.text}"
                )
            velocity = self._excitation.wanted(now_s - self._begin_s, away)
            published = self.bridge.state_publisher.controller.published(stamp_ns)
            self._sent.append((now_s - self._begin_s, float(velocity[0])))
            if published is not None:
                flown = float(velocity_enu(odometry)[0])
                self._flown.append((published.sampled_s - self._begin_s, flown))
        self.inputs.setpoint = self._setpoint.encode(stamp_ns, np.array([*velocity, 0.0, 0.0, 0.0]))

    track = odom  # a vehicle that has left the formation is tested as well

    def _end(self, problem: str) -> None:
        if not self._complete:
            self._problem = self._problem or problem
        self.inputs.take(Order(LAND))

    def points(self) -> list[FrequencyPoint]:
        """The response at each frequency, flown per sent velocity.

        Raises:
            TuneError: the test did not come to its end, or its setpoints were not its own.
        """
        if not self._complete:
            why = self._problem or self.bridge.procedure.fault or "it did not begin"
            raise TuneError(f"hover test not completed: {why}")
        if clamped := sum(self.bridge.stream.guard.clamped.values()):
            kinds = ", ".join(self.bridge.stream.guard.clamped)
            raise TuneError(
                f"{clamped} setpoints were clamped ({kinds}): "
                "expected none; fly farther from the fence, or raise the limits"
            )
        sent, flown = (np.array(rows).reshape(-1, 2) for rows in (self._sent, self._flown))
        return self._excitation.points(sent, flown)

    def identified(self) -> Identified:
        """The vehicle, as far as its parameters leave it open.

        Raises:
            TuneError: see `points`; or its parameters are unknown, or do not explain what it flew.
        """
        points, response = self.points(), self.bridge.stream.response
        if response is None:
            raise TuneError(
                "the vehicle did not answer all parameters of its velocity loop: see above, and docs/tuning.md"
            )
        # Half the round trip, and the period of the stream.
        delay_s = 0.5 * self.bridge.maintenance.sync.round_trip_s + self._period_s
        return identified(response, points, delay_s)


def fly_hover_test(
    scenario: Scenario,
    uav: int,
    key: Path | None,
    log: Callable[[str], None],
    *,
    allow_arming: bool,
    box_m: float,
) -> Identified:
    """Fly one vehicle and identify it; the first signal lands it, the second one ends this at once.

    `key` is a key file instead of the scenario's; without `allow_arming` a pilot arms; `box_m` is the side of the box
    that the vehicle must not leave.

    Raises:
        TuneError: no result, with the reason.
    """
    folder = runtime_folder(environment.named_domain())
    if (held := latched(folder)).what:
        raise TuneError(
            f"the operator's order {held.text!r} still holds: expected none; ptnsbc stop --clear releases it"
        )
    settings = scenario.vehicle_link(uav)
    path = str(key or settings.signing_key or "")
    with closing(open_link(settings, path)) as link:
        clocks = time.monotonic, time.time_ns
        test = HoverTest(scenario, uav, link, *clocks, log, allow_arming=allow_arming, box_m=box_m)
        environment.prefer_punctuality()
        desk = OrderDesk(test.bridge, scenario, uav, path, folder)
        with closing(desk), StopRequest() as request:
            while not test.over:
                link.wait(_WAIT_S)
                test.serve()
                if request.count > 1:
                    raise KeyboardInterrupt
                if request.came:
                    test.land()
                desk.keep()
            test.bridge.leave()
    return test.identified()
