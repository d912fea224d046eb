"""Time base: closed forms of docs/method.md, and why the printed forms cannot stand."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from on_arrays import on_arrays
from scipy.integrate import solve_ivp

from ptnsbc_core.errors import GainError
from ptnsbc_core.timebase import (
    Clock,
    feasible_deadline,
    h,
    h_rate,
    homing_speed,
    loop_gain,
    peak_gain,
    plan_step,
    soft_start,
    step_gain,
    task_acceleration,
    task_rate,
)
from ptnsbc_core.types import PROFILE_PAPER, PROFILE_REFERENCE, PROFILE_SOFT, PROFILES, LoopGain

task_rate = on_arrays(task_rate)

H = np.poly1d([-20, 70, -84, 35, 0, 0, 0, 0])

TF, Q = 5.0, 1e-2

durations = st.floats(0.1, 100.0)
residuals = st.floats(1e-4, 0.5)


def end_of(rate, duration=TF):
    """x(tf) / x(0) of x_dot = rate(t) x, integrated continuously."""
    out = solve_ivp(lambda t, x: rate(t) * x, (0.0, duration), [1.0], rtol=1e-11, atol=1e-13)
    return out.y[0, -1]


def test_h_is_the_polynomial_of_32_with_its_sign_turned() -> None:
    for s in np.linspace(0.0, 1.0, 41):
        assert h(float(s)) == pytest.approx(H(s), abs=1e-14)
        assert h_rate(float(s), TF) == pytest.approx(H.deriv()(s) / TF, abs=1e-13)


def test_h_stays_at_its_ends_outside_the_interval() -> None:
    assert [h(s) for s in (-1.0, 0.0, 0.5, 1.0, 3.0)] == [0.0, 0.0, 0.5, 1.0, 1.0]
    assert [h_rate(s, TF) for s in (-1.0, 0.0, 1.0, 3.0)] == [0.0] * 4


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_exactly_three_derivatives_vanish_at_the_ends(end: float) -> None:
    assert [H.deriv(order)(end) for order in (1, 2, 3)] == [0.0] * 3
    assert H.deriv(4)(end) != 0.0
    # and so for the code: what remains beside the end is 35 s^4
    s = 1e-3
    beside = h(s) if end == 0.0 else 1.0 - h(1.0 - s)
    assert beside / s**4 == pytest.approx(35.0, rel=3e-3)


def test_h_rises_monotonically() -> None:
    values = [h(float(s)) for s in np.linspace(0.0, 1.0, 1001)]
    assert np.all(np.diff(values) > 0.0)


def test_continuous_loop_follows_the_closed_form() -> None:
    times = np.linspace(0.0, TF, 21)
    found = solve_ivp(
        lambda t, x: -h_rate(t / TF, TF) / (1.0 - h(t / TF) + Q) * x,
        (0.0, TF),
        [3.0],
        t_eval=times,
        rtol=1e-11,
        atol=1e-13,
    ).y[0]
    expected = [3.0 * (1.0 - h(t / TF) + Q) / (1.0 + Q) for t in times]
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    assert expected[-1] == pytest.approx(3.0 * Q / (1.0 + Q), rel=1e-12)


def test_printed_sign_of_32_makes_the_error_grow() -> None:
    grown = end_of(lambda t: h_rate(t / TF, TF) / (1.0 + h(t / TF) + Q))
    assert grown == pytest.approx((2.0 + Q) / (1.0 + Q), rel=1e-8)


def test_printed_factor_of_31_leaves_a_tenth() -> None:
    halved = end_of(lambda t: -h_rate(t / TF, TF) / (2.0 * (1.0 - h(t / TF) + Q)))
    assert halved == pytest.approx(np.sqrt(Q / (1.0 + Q)), rel=1e-6)  # 0.0995, not 0.0099


def test_printed_52_never_lets_its_gain_go() -> None:
    # h in place of h_dot, lambda = 1: Xi = h / (2 (1 - h + q)) is 1 / (2 q) from tf on
    after = [h(t / TF) / (2.0 * (1.0 - h(t / TF) + Q)) for t in (TF, 2.0 * TF, 100.0 * TF)]
    np.testing.assert_allclose(after, 1.0 / (2.0 * Q))
    assert step_gain(TF, 0.01, TF, Q) == 0.0


@given(duration=durations, residual=residuals, ticks=st.integers(1, 400), start=st.floats(-9, 9))
def test_step_gain_meets_the_closed_form_at_every_step(
    duration: float, residual: float, ticks: int, start: float
) -> None:
    dt = duration / ticks
    x = start
    for k in range(ticks):
        x -= dt * step_gain(k * dt, dt, duration, residual) * x
        left = 1.0 - h((k + 1) * dt / duration) + residual
        assert x == pytest.approx(start * left / (1.0 + residual), rel=1e-9, abs=1e-300)
    # the same residual whether the deadline is reached in one step or in 400
    assert x == pytest.approx(start * residual / (1.0 + residual), rel=1e-9, abs=1e-300)


@given(duration=durations, residual=residuals, share=st.floats(0.0, 3.0))
@example(duration=1.0, residual=0.5, share=0.99999)  # the polynomial itself rounds above 1 here
def test_step_gain_never_overshoots(duration: float, residual: float, share: float) -> None:
    for dt in (duration / 1000.0, duration / 3.0, 2.0 * duration):
        gain = step_gain(share * duration, dt, duration, residual)
        assert 0.0 <= dt * gain < 1.0


@pytest.mark.parametrize(("residual", "peak"), [(1e-2, 2.72), (1e-3, 5.48), (1e-4, 10.3)])
def test_peak_gain_of_the_design(residual: float, peak: float) -> None:
    assert f"{peak_gain(5.0, residual):.3g}" == f"{peak}"
    assert peak_gain(10.0, residual) == pytest.approx(peak_gain(5.0, residual) / 2.0)
    assert peak_gain(5.0, residual) == pytest.approx(
        (5.544 * residual**-0.25 - 3.8) / 5.0, rel=2e-2
    )


@pytest.mark.parametrize("residual", [0.5, 1e-2, 1e-4])
def test_peak_gain_bounds_the_gain_as_flown(residual: float) -> None:
    dt = 1e-3
    flown = max(step_gain(float(t), dt, TF, residual) for t in np.arange(0.0, TF, dt))
    assert flown < peak_gain(TF, residual)
    # a step of gain g decays as Xi = -ln(1 - dt g) / dt does over dt
    assert -np.log1p(-dt * flown) / dt == pytest.approx(peak_gain(TF, residual), rel=1e-4)


@pytest.mark.parametrize(
    ("duration", "residual", "said"),
    [(0.0, 0.1, "tf=0"), (np.inf, 0.1, "tf=inf"), (5.0, 0.0, "q=0"), (5.0, 1.0, "q=1.0")],
)
def test_gain_out_of_range_is_refused(duration: float, residual: float, said: str) -> None:
    with pytest.raises(GainError, match=said):
        peak_gain(duration, residual)


@pytest.mark.parametrize(("error", "speed", "acceleration"), [(8.0, 2.0, 50.0), (8.0, 90.0, 3.0)])
def test_feasible_deadline_just_meets_the_limits(
    error: float, speed: float, acceleration: float
) -> None:
    duration = feasible_deadline(error, speed, acceleration)
    s = np.linspace(0.0, 1.0, 100001)
    fastest = error * np.max(np.abs(H.deriv()(s))) / duration
    hardest = error * np.max(np.abs(H.deriv(2)(s))) / duration**2
    assert fastest <= speed * (1.0 + 1e-4)
    assert hardest <= acceleration * (1.0 + 1e-4)
    assert max(fastest / speed, hardest / acceleration) == pytest.approx(1.0, rel=1e-4)


def test_who_may_not_move_has_no_feasible_deadline():
    assert feasible_deadline(1.0, 0.0, 2.0) == feasible_deadline(1.0, 2.0, 0.0) == np.inf
    assert feasible_deadline(0.0, 0.0, 2.0) == 0.0


def gain_of(profile: int) -> LoopGain:
    return LoopGain(TF, Q, 1.5, 2.0, profile)


def test_paper_profile_has_its_constant_from_the_start() -> None:
    assert loop_gain(gain_of(PROFILE_PAPER), Clock(0.0, 0.0, 1e-3)) == pytest.approx(1.5 * 2.0)


def test_soft_profile_starts_at_zero_and_ends_at_kappa() -> None:
    soft = gain_of(PROFILE_SOFT)
    assert loop_gain(soft, Clock(0.0, 0.0, 1e-3)) < 1e-8
    assert loop_gain(soft, Clock(TF, TF, 1e-3)) == 1.5 * 2.0
    t = 0.4 * TF
    assert loop_gain(soft, Clock(t, t, 1e-3)) == pytest.approx(
        1.5 * (step_gain(t, 1e-3, TF, Q) + 2.0 * h(0.4))
    )


def test_rearm_stays_firm() -> None:
    """A new epoch takes the time base back to zero, not the constant part."""
    soft = gain_of(PROFILE_SOFT)
    rearmed = Clock(0.0, 12.0, 1e-3)
    assert soft_start(soft, rearmed) == 1.0
    assert loop_gain(soft, rearmed) == pytest.approx(1.5 * 2.0)


@pytest.mark.parametrize("dt", [0.01, 0.25])
def test_reference_profile_follows_its_plan_exactly(dt: float) -> None:
    gain = LoopGain(TF, Q, 1.0, 2.0, PROFILE_REFERENCE)
    start = np.array([2.0, -1.0, 0.3])
    error = start.copy()
    for k in range(round(TF / dt)):
        error = error - dt * task_rate(gain, error, start, Clock(k * dt, k * dt, dt))
        np.testing.assert_allclose(error, start * (1.0 - h((k + 1) * dt / TF)), atol=1e-12)


def test_reference_profile_shows_noise_to_kappa_only() -> None:
    gain = LoopGain(TF, Q, 1.0, 2.0, PROFILE_REFERENCE)
    start = np.array([2.0, -1.0, 0.3])
    noise = np.array([0.1, 0.0, -0.2])
    for t in (0.0, 0.7 * TF, TF):
        clock = Clock(t, t, 0.01)
        on = start * (1.0 - h(t / TF))
        more = task_rate(gain, on + noise, start, clock) - task_rate(gain, on, start, clock)
        np.testing.assert_allclose(more, 2.0 * noise, atol=1e-12)


def test_loop_rate_is_gain_times_error_elsewhere() -> None:
    error = np.array([2.0, -1.0, 0.3])
    clock = Clock(2.0, 2.0, 0.01)
    for profile in (PROFILE_PAPER, PROFILE_SOFT):
        rate = task_rate(gain_of(profile), error, np.zeros(3), clock)
        np.testing.assert_allclose(rate, loop_gain(gain_of(profile), clock) * error)


def test_a_residual_without_bound_takes_the_time_base_out() -> None:
    """`time_base: false` of a scenario: the gain is scale kappa from the first instant to the last."""
    gain = LoopGain(TF, np.inf, 0.5, 3.0, PROFILE_PAPER)
    for t in (0.0, 1.0, 2.5, 4.99, 5.0, 9.0):
        assert loop_gain(gain, Clock(t, t, 0.01)) == 1.5
    assert peak_gain(TF, np.inf) == 0.0


@pytest.mark.parametrize("profile", PROFILES.values())
def test_task_acceleration_is_the_change_of_the_rate_on_the_planned_error(profile: int) -> None:
    gain = LoopGain(5.0, 1e-2, 1.0, 2.0 if profile != PROFILE_REFERENCE else 0.0, profile)
    error = start = (1.0, -2.0, 0.5)
    for k in range(600):
        clock = Clock(k * 0.01, k * 0.01, 0.01)
        rate = task_rate(gain, error, start, clock)
        acceleration = task_acceleration(gain, error, start, clock)
        error = tuple(e - 0.01 * r for e, r in zip(error, rate, strict=True))
        later = Clock(clock.t + 0.01, clock.start_t + 0.01, 0.01)
        after = task_rate(gain, error, start, later)
        change = (np.array(after) - np.array(rate)) / 0.01
        np.testing.assert_allclose(acceleration, change, atol=1e-9)


def test_plan_step_is_one_minus_h_and_its_differences() -> None:
    for k in (0, 120, 300, 449, 460):
        now, after = (plan_step(4.5, Clock(j * 0.01, j * 0.01, 0.01)) for j in (k, k + 1))
        assert now.left == pytest.approx(1.0 - h(k * 0.01 / 4.5), abs=1e-15)
        assert now.rate == pytest.approx((now.left - after.left) / 0.01, abs=1e-12)
        assert now.acceleration == pytest.approx((after.rate - now.rate) / 0.01, abs=1e-9)


@given(gain=st.floats(0.3, 5.0), brake=st.floats(1.0, 20.0), far=st.floats(0.0, 30.0))
def test_homing_is_the_gain_near_by_and_constant_braking_from_afar(
    gain: float, brake: float, far: float
) -> None:
    speed = homing_speed(far, gain, brake)
    assert speed <= gain * far + 1e-9
    step = 1e-6
    slope = (homing_speed(far + step, gain, brake) - speed) / step
    assert speed * slope <= brake * (1.0 + 1e-3) + 1e-4
    edge = brake / gain**2
    below, above = (homing_speed(edge * share, gain, brake) for share in (1 - 1e-9, 1 + 1e-9))
    assert below == pytest.approx(above, rel=1e-6)
