"""Pre-flight checks of gains and deadlines against control period, limits of the vehicle and positioning."""

from __future__ import annotations

import math

from ptnsbc_core.timebase import peak_gain
from ptnsbc_sim.disturbances.noise import correction_std_m, position_noise_of, position_std_m
from ptnsbc_sim.scenario import Scenario, agent_config
from ptnsbc_sim.scenario.approach.deadline import (
    limits_left,
    limits_left_by_mission,
    longest_need,
    shortest_deadlines,
    start_errors,
)
from ptnsbc_sim.scenario.semantics import STABILITY_LIMIT
from ptnsbc_sim.scenario.slots import with_slots_of_starts
from ptnsbc_tools.check.finding import ERROR, WARNING, Findings, judge

_SMOOTH_STEP = 1.0  # above this a sampled decay overshoots, above STABILITY_LIMIT it grows
_RARE = 1e-3  # share of flights that may miss for their positioning alone, without a warning
_RARE_SIGMAS = 4.0331  # a Maxwell variable is above it with this probability


def steps(scenario: Scenario) -> Findings:
    """Control period times the largest gain of every loop."""
    gains = scenario.gains
    config = agent_config(scenario, scenario.leader.id)  # as flown: a profile may fix kappa
    dt = 1.0 / scenario.timing.control_hz
    slide = gains.adaptation.cap_m_s2 / gains.boundary.velocity_m_s
    turn = gains.adaptation.cap_rad_s2 / gains.boundary.rate_rad_s
    loops = {
        "gains.formation": (config.formation, 0.0),
        "gains.attitude": (config.attitude, 0.0),
        "gains.clearance": (config.clearance.gain, 0.0),
        "gains.force": (config.controller.force, slide),
        "gains.torque": (config.controller.torque, turn),
    }
    rates = {
        key: loop.scale * (peak_gain(loop.duration_s, loop.residual) + loop.kappa) + more
        for key, (loop, more) in loops.items()
    } | {
        "gains.filter.bandwidth_1_s": gains.filter.bandwidth_1_s,
        "gains.filter.rate_bandwidth_1_s": gains.filter.rate_bandwidth_1_s,
    }
    for key, rate in rates.items():
        step = dt * rate
        severity = ERROR if step >= STABILITY_LIMIT else WARNING
        advice = (
            "lengthen its deadline, raise its residual, lower kappa, or raise timing.control_hz"
        )
        limit = f"< {STABILITY_LIMIT:g}, smooth below {_SMOOTH_STEP:g}"
        advice = advice if step > _SMOOTH_STEP else ""
        yield judge(key, f"dt times gain {step:.2f}", limit, advice, severity)


def order(scenario: Scenario) -> Findings:
    """Deadlines of the inner loops, which must end before the deadline of the formation."""
    gains = scenario.gains
    outer = gains.formation.deadline_s
    for key in ("estimator", "force", "torque"):
        inner = getattr(gains, key).deadline_s
        if inner >= outer:
            limit = f"< gains.formation.deadline_s, {outer:g} s"
            advice = "an inner loop has to be done before the formation is; shorten it"
            yield judge(f"gains.{key}.deadline_s", f"{inner:g} s", limit, advice)


def printed(scenario: Scenario) -> Findings:
    """The printed gains on a quadrotor, which must tilt before it can accelerate sideways."""
    if scenario.gains.profile == "paper" and scenario.plant.kind == "quadrotor":
        limit = "soft or reference, or plant.kind rigid_body_6dof"
        advice = (
            "flown so, paper_5 saturates: no UAV meets the deadline, three of them are metres off"
        )
        yield judge("gains.profile", "paper on a quadrotor", limit, advice)


def changes(scenario: Scenario) -> Findings:
    """The changes of the shape against the limits of speed and acceleration, and against the deadline."""
    shapes = scenario.formation.changes
    if not shapes or not scenario.followers or scenario.mission is not None:
        return
    left = limits_left_by_mission(scenario, 0.0, scenario.timing.duration_s)
    value = (
        f"they leave {left.speed_m_s:.2f} m/s and {left.acceleration_m_s2:.2f} m/s^2 of the limits"
    )
    advice = "lengthen over_s, or bring the shapes closer together" if min(left) <= 0 else ""
    yield judge("formation.changes", value, "> 0", advice, ERROR)
    deadline, first_s = scenario.gains.formation.deadline_s, shapes[0].at_s
    if first_s < deadline:
        limit = f">= {deadline:g} s, gains.formation.deadline_s"
        advice = "let the first shape come about before it changes"
        yield judge("formation.changes[0].at_s", f"{first_s:g} s", limit, advice)


def within_flight(scenario: Scenario) -> Findings:
    """The length of the flight: until the deadline, and long enough after it to be judged."""
    deadline, duration = scenario.gains.formation.deadline_s, scenario.timing.duration_s
    if deadline >= duration:
        value = f"{duration:g} s: the flight ends before its deadline"
        limit = f"> {deadline:g} s, gains.formation.deadline_s"
        advice = "the verdict will be void: fly longer, or set an earlier deadline"
        yield judge("timing.duration_s", value, limit, advice)


def feasible(scenario: Scenario) -> Findings:
    """The formation deadline against the limits of speed and acceleration, from the actual starts."""
    deadline = scenario.gains.formation.deadline_s
    scenario = with_slots_of_starts(scenario)
    left = limits_left(scenario)
    if min(left) <= 0:
        speed, acceleration = left
        key = "gains.filter.max_speed_m_s" if speed <= 0 else "plant"
        value = f"{speed if speed <= 0 else acceleration:.2f} left beside the leader's motion"
        yield judge(key, value, "> 0", "slow the leader down, or raise the limit", ERROR)
        return
    away, (last, need_s) = start_errors(scenario), longest_need(scenario, left)
    short = 0
    if need_s > deadline:
        needs = shortest_deadlines(scenario, left)
        short = sum(need > deadline for need in needs.values())
    hundredths = 100.0 * need_s  # as it is printed: never rounded down
    shortest = math.ceil(hundredths) / 100.0 if math.isfinite(hundredths) else need_s
    too_short = f", too short for {short} of {len(away)} UAVs" if short else ""
    start = f"UAV {last} has {away[last]:.2f} m to fly to its place and needs {shortest:.2f} s"
    value = f"{deadline:g} s{too_short}; {start}"
    limits = f"{left.speed_m_s:.3g} m/s and {left.acceleration_m_s2:.3g} m/s^2"
    limit = f">= {shortest:.2f} s, with {limits} beside the leader's largest motion"
    longer = f"set gains.formation.deadline_s to at least {shortest:.2f} s or to auto"
    advice = f"{longer}, start it closer, or raise gains.filter.max_speed_m_s" if short else ""
    yield judge("gains.formation.deadline_s", value, limit, advice, ERROR)


def leader_error_std_m(scenario: Scenario) -> float:
    """Standard deviation per axis of the true error of the leader [m] that its position fixes leave.

    The measured position is off by the error of the navigation filter, and jumps at each fix. The leader flies a
    jump back with kappa and the lag tau: x_dot = -kappa x(t - tau), whose variance under jumps is that without a lag
    times (1 + sin kappa tau) / cos kappa tau (Kuechler and Mensch 1992). Both parts are uncorrelated, because the
    filter is optimal, see docs/notes/fixes.md.
    """
    kind, dt = position_noise_of(scenario), 1.0 / scenario.timing.control_hz
    if kind.period == 0:
        return 0.0
    config = agent_config(scenario, scenario.leader.id)
    kappa = config.formation.scale * config.formation.kappa
    turn = kappa * config.clearance.lag_s
    if turn >= 0.5 * math.pi:
        return math.inf
    left = -math.expm1(-2.0 * kappa * kind.period * dt)
    slower = (1.0 + math.sin(turn)) / math.cos(turn)
    flown = correction_std_m(kind, dt) * math.sqrt(slower / left)
    return math.hypot(position_std_m(kind, dt), flown)


def positioning(scenario: Scenario) -> Findings:
    """The tolerance against the error that the leader's own position fixes leave."""
    sigma, tolerance = leader_error_std_m(scenario), scenario.formation.tolerance_m
    if not sigma > 0.0:
        return
    ratio = tolerance / sigma
    share = math.erfc(ratio / math.sqrt(2.0))
    share += math.sqrt(2.0 / math.pi) * ratio * math.exp(-0.5 * ratio * ratio)  # Maxwell
    value = (
        f"the leader is {1e3 * sigma:.1f} mm off per axis (standard deviation), "
        f"and at the deadline outside {tolerance:g} m in {100 * share:.2g} % of flights"
    )
    larger = f"raise formation.tolerance_m to {_RARE_SIGMAS * sigma:.3f} m"
    advice = "" if share <= _RARE else f"{larger}, or take a receiver with less noise_m"
    yield judge("sensor.positioning", value, f"<= {100 * _RARE:g} %", advice)
