"""From the response of a vehicle to the settings of the formation: lag of the tilt, κ, filter, residual, deadline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from ptnsbc_core.timebase import Clock, h, loop_gain, plan_duration
from ptnsbc_core.types import Array, LoopGain
from ptnsbc_io.mavlink.autopilots import VelocityResponse
from ptnsbc_nodes.bridge.setpoint.velocity_lead import (
    PLANNER_DELAY_S,
    flown_per_wanted,
    inverse,
    largest_kappa_1_s,
)
from ptnsbc_nodes.bridge.tuning.excitation import FrequencyPoint, TuneError
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.approach.deadline import longest_need, start_errors
from ptnsbc_sim.scenario.approach.limits import limits_left

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

    Args:
        response: the velocity loop by the vehicle's parameters.
        points: what was measured.
        delay_s: known delay between setpoint and vehicle.

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
    shortest = _shortest_s(loop, vehicle, share, _limit_s(scenario), lead=lead)
    return Settings(
        kappa, most, filter_1_s, residual, max(float(own.deadline_s), shortest), shortest
    )


def _limit_s(scenario: Scenario) -> float:
    """The deadline that speed and acceleration allow."""
    left = limits_left(scenario)
    if min(left) <= 0.0:
        raise TuneError(
            f"{scenario.source}: the leader's motion leaves nothing of the limits: see ptnsbc check"
        )
    return longest_need(scenario, left).deadline_s


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
