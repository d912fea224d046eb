"""The inverse of a vehicle's response: vehicles of closed form, and the stand-ins."""

import math
from itertools import product

import numpy as np
import pytest
from scipy.signal import bilinear_zpk, sosfilt, sosfilt_zi, tf2zpk, zpk2sos

pytest.importorskip("pymavlink")

from ptnsbc_core.kinematics import quaternion_from_euler, rotation_from_quaternion
from ptnsbc_io.mavlink.autopilots import VelocityResponse
from ptnsbc_nodes.bridge.setpoint.velocity_lead import (
    DragEstimator,
    Following,
    FollowingEstimator,
    VelocityLead,
    flown_per_wanted,
    inverse,
    largest_kappa_1_s,
)

ARDUPILOT = VelocityResponse(2.0, 1.0, 0.5, 1.0, 2.0, (0.15, 0.227))
PX4 = VelocityResponse(1.8, 0.4, 0.2, 0.0, None, (0.1, 0.06))
KINDS = pytest.mark.parametrize("response", [ARDUPILOT, PX4])
PERIOD_S = 0.02


def flown(response, drag, s, **smoothing):
    """Velocity flown per velocity wanted: the vehicle behind its lead."""
    return flown_per_wanted(response, inverse(response, **smoothing), drag, s)


@KINDS
def test_without_low_passes_the_vehicle_flies_exactly_what_is_wanted(response):
    for drag, hertz in product((0.0, 0.2, 1.0), (0.02, 0.1, 0.25, 0.5, 2.0)):
        found = flown(response, drag, 2j * math.pi * hertz, smoothing_s=0.0)
        assert found == pytest.approx(1.0, rel=1e-9), (drag, hertz)


@KINDS
def test_low_passes_cost_a_tenth_of_a_second(response):
    for drag, hertz in product((0.0, 0.2, 1.0), (0.02, 0.1, 0.25, 0.5)):
        s = 2j * math.pi * hertz
        found = flown(response, drag, s)
        assert 0.85 < abs(found) < 1.35, (drag, hertz)
        assert abs(np.angle(found)) / abs(s) < 0.25, (drag, hertz)


@KINDS
@pytest.mark.parametrize("drag", [0.0, 1.0])
@pytest.mark.parametrize("kappa", [1.0, 1.5, 2.2])
def test_a_formation_loop_around_it_does_not_overshoot(response, drag, kappa):
    """ArduCopter without the lead has a peak above 4 at 1.5 1/s."""
    delay_s = 0.08
    peak = 0.0
    for w in np.geomspace(0.05, 20.0, 150):
        loop = kappa / (1j * w) * np.exp(-1j * w * delay_s) * flown(response, drag, 1j * w)
        peak = max(peak, abs(loop / (1 + loop)))
    assert peak < (1.1 if kappa < 2.0 else 1.35)


@pytest.mark.parametrize(("response", "least", "most"), [(ARDUPILOT, 0.4, 1.0), (PX4, 0.8, 2.5)])
def test_the_lead_allows_gains_that_the_vehicle_alone_does_not(response, least, most):
    """Flown on ArduCopter: 1.5 1/s swings, 0.6 1/s does not."""
    assert least < largest_kappa_1_s(response, lead=False) < most
    assert largest_kappa_1_s(response, lead=True) >= 1.4 - 1e-9


@KINDS
def test_no_gain_fits_a_vehicle_whose_own_loop_is_not_stable(response):
    assert largest_kappa_1_s(response.measured(None, 2.0), lead=True) == 0.0
    assert largest_kappa_1_s(response.measured(None, 2.0), lead=False) == 0.0


@pytest.mark.parametrize(
    "response",
    [ARDUPILOT, ARDUPILOT._replace(integral=0.0), PX4, PX4._replace(integral=0.0)],
    ids=["ardupilot", "ardupilot-without-integral", "px4", "px4-without-integral"],
)
def test_a_steady_velocity_is_sent_as_it_is_with_the_push_against_the_drag(response):
    lead = VelocityLead(response, PERIOD_S)
    for _ in range(500):
        velocity, push = lead.setpoint(np.array([1.0, -0.5]), 0.3)
    assert velocity == pytest.approx([1.0, -0.5], abs=1e-9)
    expected = 0.0 if response.shaping_1_s else 0.3
    assert push == pytest.approx([expected, -0.5 * expected], abs=1e-9)


def test_a_vehicle_without_integral_and_position_loop_is_pushed_by_its_setpoint():
    """Nothing else of it holds a velocity against the drag: the additions are finite and constant."""
    response = ARDUPILOT._replace(integral=0.0, position_gain=0.0)
    lead = VelocityLead(response, PERIOD_S)
    for _ in range(500):
        velocity, push = lead.setpoint(np.array([1.0, -0.5]), 0.3)
    against = 0.3 / response.gain
    assert velocity == pytest.approx([1.0 + against, -0.5 * (1.0 + against)], abs=1e-9)
    assert push == pytest.approx([0.0, 0.0], abs=1e-9)


@KINDS
def test_a_new_sequence_begins_without_a_kick(response):
    lead = VelocityLead(response, PERIOD_S)
    lead.setpoint(np.zeros(2), 0.2)
    lead.restart()
    velocity, push = lead.setpoint(np.array([2.0, 0.0]), 0.0)
    assert velocity == pytest.approx([2.0, 0.0])
    assert push == pytest.approx([0.0, 0.0], abs=1e-5)


def filtered(transfer, wanted):
    """The wanted velocities (N, 2) through a transfer function, by SciPy in one call; it was at rest at the first."""
    above, below = transfer.above.coef[::-1], transfer.below.coef[::-1]
    sections = zpk2sos(*bilinear_zpk(*tf2zpk(above, below), 1.0 / PERIOD_S))
    rest = sosfilt_zi(sections)[:, :, None] * wanted[0]
    return sosfilt(sections, wanted, axis=0, zi=rest)[0]


@KINDS
def test_sample_by_sample_it_is_the_filter_that_scipy_makes_of_the_whole(response):
    wanted = np.random.default_rng(7).uniform(-2.0, 2.0, (500, 2)).cumsum(axis=0)
    made, drag = inverse(response), 0.4
    push = filtered(made.acceleration[0], wanted) + drag * filtered(made.acceleration[1], wanted)
    ahead = np.zeros((500, 2))
    if made.velocity is not None:
        ahead = filtered(made.velocity[0], wanted) + drag * filtered(made.velocity[1], wanted)
    lead = VelocityLead(response, PERIOD_S)
    sent = np.array([lead.setpoint(velocity, drag) for velocity in wanted])
    assert np.abs(sent[:, 0] - wanted - ahead).max() <= 1e-12 * np.abs(wanted).max()
    assert np.abs(sent[:, 1] - push).max() <= 1e-12 * np.abs(push).max()


@KINDS
def test_the_filters_forget(response):
    lead = VelocityLead(response, PERIOD_S)
    random = np.random.default_rng(5)
    for _ in range(2000):
        lead.setpoint(random.uniform(-1.0, 1.0, 2), 1.0)
    for _ in range(1000):
        sent = lead.setpoint(np.zeros(2), 1.0)
    assert np.abs(np.array(sent)).max() < 1e-3


def tilted(drag, wind, seconds, seed=1, noise=0.0):
    """Odometry of a vehicle that flies circles with this drag in this wind."""
    random = np.random.default_rng(seed)
    velocity = np.zeros(2)
    for n in range(round(seconds / PERIOD_S)):
        t = n * PERIOD_S
        push = 0.8 * np.array([math.sin(0.9 * t), math.cos(0.7 * t)])
        velocity = velocity + PERIOD_S * (push - drag * (velocity - wind))
        odometry = np.zeros(13)
        odometry[3:7] = quaternion_from_euler(
            np.array(
                [
                    -math.atan(push[1] / 9.81 * math.cos(math.atan(push[0] / 9.81))),
                    math.atan(push[0] / 9.81),
                    0,
                ]
            )
        )
        rotation = rotation_from_quaternion(odometry[3:7])
        seen = np.append(velocity + noise * random.standard_normal(2), 0.0)
        odometry[7:10] = rotation.T @ seen
        yield t, odometry


@pytest.mark.parametrize("drag", [0.0, 0.2, 1.0])
def test_the_drag_is_learned_in_wind(drag):
    estimator = DragEstimator(9.81)
    for t, odometry in tilted(drag, np.array([2.0, -1.0]), 30.0, noise=0.005):
        estimator.on_odometry(t, odometry)
    assert estimator.value == pytest.approx(drag, abs=0.06)


def test_a_vehicle_that_hovers_keeps_the_first_guess():
    estimator = DragEstimator(9.81)
    odometry = np.zeros(13)
    odometry[6] = 1.0
    for n in range(1500):
        estimator.on_odometry(n * PERIOD_S, odometry)
    assert estimator.value == pytest.approx(0.2, abs=1e-6)


def test_a_gap_teaches_nothing():
    estimator = DragEstimator(9.81)
    for t, odometry in tilted(1.0, np.zeros(2), 5.0):
        estimator.on_odometry(20.0 * t, odometry)
    assert estimator.value == pytest.approx(0.2)


PERIOD_S = 0.02


def wanted(t):
    """A path with several periods, as a formation flies them [m/s]."""
    return np.array([0.5 * math.sin(0.7 * t), 0.4 * math.cos(0.9 * t) + 0.2, 0.3])


def told(seconds, gain=1.0, lag_s=0.0, noise=0.0, path=wanted, start=100.0):
    random = np.random.default_rng(2)
    made = FollowingEstimator()
    for n in range(round(seconds / PERIOD_S)):
        t = start + n * PERIOD_S
        flown = gain * path(t - lag_s) + noise * random.standard_normal(3)
        made.add(t, path(t), flown)
    return made.found()


@pytest.mark.parametrize("gain", [0.6, 1.0, 1.2])
@pytest.mark.parametrize("lag_s", [0.0, 0.1, 0.5])
def test_gain_and_lag_are_found_in_noise(gain, lag_s):
    found = told(25.0, gain, lag_s, noise=0.05)
    assert found.gain == pytest.approx(gain, rel=0.05)
    assert found.lag_s == pytest.approx(lag_s, abs=0.051)


@pytest.mark.parametrize("path", [lambda _: np.zeros(3), lambda _: np.array([1.0, 0.5, 0.0])])
def test_a_vehicle_that_does_not_change_its_velocity_shows_nothing(path):
    assert told(25.0, path=path) is None


def test_a_few_seconds_show_nothing():
    assert told(9.0) is None


def test_a_gap_begins_anew():
    made = FollowingEstimator()
    for n in range(1000):
        t = n * PERIOD_S
        made.add(t, wanted(t), wanted(t))
    made.add(30.0, wanted(30.0), wanted(30.0))
    assert made.found() is None


def test_only_the_last_half_minute_counts():
    made = FollowingEstimator()
    for n in range(3500):
        t = n * PERIOD_S
        made.add(t, wanted(t), wanted(t) * (0.5 if t < 35.0 else 1.0))
    assert made.found().gain == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize(
    ("gain", "lag_s", "near"),
    [(1.0, 0.1, True), (1.25, 0.3, True), (0.6, 0.1, False), (1.0, 0.5, False)],
)
def test_a_vehicle_unlike_the_prediction_is_told(gain, lag_s, near):
    assert (Following(gain, lag_s).unlike == "") is near
    assert near or f"gain {gain:.2f}, {lag_s:.2f} s late" in Following(gain, lag_s).unlike
