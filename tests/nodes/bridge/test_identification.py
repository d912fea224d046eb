"""The velocities of a hover test, and the response that is found in what was flown."""

import math

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from ptnsbc_core.types import PROFILE_SOFT, LoopGain
from ptnsbc_io.mavlink.autopilots import VelocityResponse
from ptnsbc_nodes.bridge.identification import (
    Excitation,
    FrequencyPoint,
    Identified,
    TuneError,
    approach,
    identified,
    impulse_response,
    settings,
)
from ptnsbc_sim.scenario import load_scenario

PERIOD_S = 0.02


def flown(made, gain=1.0, lag_s=0.0, noise_m_s=0.0, drift_m_s2=0.0):
    """What was sent, and what a vehicle of this gain and lag flew."""
    random = np.random.default_rng(3)
    t = np.arange(0.0, made.end_s, PERIOD_S)
    sent = np.array([made.wanted(at, np.zeros(3))[0] for at in t])
    late = np.array([made.wanted(at - lag_s, np.zeros(3))[0] for at in t])
    seen = gain * late + drift_m_s2 * t + noise_m_s * random.standard_normal(len(t))
    return np.stack((t, sent), axis=1), np.stack((t + 0.007, np.interp(t + 0.007, t, seen)), axis=1)


@pytest.mark.parametrize(("gain", "lag_s"), [(1.0, 0.0), (0.6, 0.5), (1.2, 0.3)])
def test_gain_and_lag_are_found_beside_noise_and_drift(gain, lag_s):
    made = Excitation(3.0)
    for point in made.points(*flown(made, gain, lag_s, noise_m_s=0.03, drift_m_s2=0.01)):
        assert point.gain == pytest.approx(gain, rel=0.03)
        assert point.lag_s == pytest.approx(lag_s, abs=0.02)


def test_a_vehicle_that_flies_by_itself_is_refused():
    made = Excitation(3.0)
    with pytest.raises(TuneError, match="not asked for"):
        made.points(*flown(made, noise_m_s=0.6))


def test_too_few_states_are_refused():
    made = Excitation(3.0)
    sent, seen = flown(made)
    with pytest.raises(TuneError, match=r"samples at 0\.1 Hz"):
        made.points(sent, seen[::50])


@pytest.mark.parametrize("box_m", [1.2, 2.0, 3.0, 6.0])
def test_the_sinusoids_take_at_most_the_box_and_half_a_metre_per_second(box_m):
    made = Excitation(box_m)
    place, widest = np.zeros(3), 0.0
    for at in np.arange(0.0, made.end_s, PERIOD_S):
        velocity = made.wanted(at, place)
        assert abs(velocity[0]) <= 0.5 + 0.3
        place = place + PERIOD_S * velocity
        widest = max(widest, abs(place[0]))
    assert 0.1 < widest < 0.5 * box_m


def test_the_middle_of_the_box_is_held():
    made = Excitation(3.0)
    assert made.wanted(0.0, np.array([0.5, -0.5, 4.0])) == pytest.approx([-0.1, 0.1, -0.3])


def test_the_box():
    made = Excitation(3.0)
    assert not made.left(np.array([1.4, -1.4, 1.4]))
    assert made.left(np.array([0.0, -1.6, 0.0]))


def test_a_box_that_shows_nothing_is_refused_with_the_least():
    with pytest.raises(TuneError, match=r"--box 0.3: expected at least 0.6 m"):
        Excitation(0.3)
    assert math.isfinite(Excitation(0.6).end_s)


ARDUPILOT = VelocityResponse(2.0, 1.0, 0.5, 1.0, 2.0, (0.15, 0.227))
PX4 = VelocityResponse(1.8, 0.4, 0.2, 0.0, None, (0.1, 0.06))
HERTZ = (0.1, 0.25, 0.5)

# Measured on PX4 1.16-dev and ArduCopter 4.7-dev: docs/autopilot.md, "How they follow a velocity".
MEASURED = {
    ARDUPILOT: ((0.98, 0.52), (1.10, 0.47), (0.85, 0.63)),
    PX4: ((0.67, 0.59), (0.59, 0.48), (0.44, 0.40)),
}


def points_of(pairs):
    return [
        FrequencyPoint(hertz, gain * np.exp(-2j * math.pi * hertz * lag_s))
        for hertz, (gain, lag_s) in zip(HERTZ, pairs, strict=True)
    ]


@pytest.mark.parametrize("response", [ARDUPILOT, PX4])
@pytest.mark.parametrize(
    ("gain", "lag", "drag"), [(1.0, 1.0, 0.2), (1.3, 0.7, 1.0), (0.7, 1.5, 0.4)]
)
def test_the_numbers_of_a_vehicle_are_found_from_its_response(response, gain, lag, drag):
    true = Identified(
        response.measured(gain * response.gain, lag * response.tilt_lag_s), drag, 0.02, ()
    )
    found = identified(response, [true.expected(hertz) for hertz in HERTZ], 0.02)
    assert found.response.gain == pytest.approx(true.response.gain, rel=1e-3)
    assert found.response.tilt_lag_s == pytest.approx(true.response.tilt_lag_s, rel=1e-3)
    assert found.drag_1_s == pytest.approx(drag, abs=1e-3)
    assert found.error < 1e-4


@pytest.mark.parametrize("response", MEASURED)
def test_what_was_measured_on_real_autopilots_is_explained_within_three_hundredths(response):
    found = identified(response, points_of(MEASURED[response]), 0.0)
    assert found.error < 0.035
    assert found.drag_1_s == pytest.approx(1.1 if response is PX4 else 0.3, abs=0.1)


def test_a_response_that_no_such_vehicle_has_is_refused():
    with pytest.raises(TuneError, match="its parameters give at best"):
        identified(PX4, points_of(((1.0, 0.1), (0.3, 0.9), (1.5, 0.1))), 0.02)


def scenario(**overrides):
    return load_scenario("experiment_4", overrides).bridged()


@pytest.mark.parametrize("response", [ARDUPILOT, PX4])
def test_settings_that_fit_are_left_alone(response):
    own = scenario()
    fits = settings(own, Identified(response, 0.2, 0.02, ()))
    assert fits.kappa_1_s == own.gains.formation.kappa_1_s < fits.largest_kappa_1_s
    assert fits.filter_1_s == own.gains.filter.bandwidth_1_s
    assert fits.deadline_s == own.gains.formation.deadline_s > fits.shortest_deadline_s


def test_settings_that_do_not_fit_become_the_next_that_do():
    vehicle = Identified(ARDUPILOT.measured(None, 0.45), 0.2, 0.06, ())
    own = scenario(
        **{
            "mavlink.overrides": {
                "gains.formation.deadline_s": 3,
                "formation.task": "relative_position",
            }
        }
    )
    fits = settings(own, vehicle)
    assert fits.kappa_1_s == fits.largest_kappa_1_s < own.gains.formation.kappa_1_s
    assert fits.filter_1_s >= 1.0 / 0.04 - 1e-9 > own.gains.filter.bandwidth_1_s
    assert fits.deadline_s == fits.shortest_deadline_s > 3


@pytest.mark.parametrize(
    ("vehicle", "text"),
    [
        (Identified(ARDUPILOT.measured(2.0, 1.5), 0.2, 0.02, ()), "make its velocity loop faster"),
        (Identified(PX4, 0.2, 0.11, ()), "expected less than 100 ms"),
    ],
)
def test_a_vehicle_that_nothing_fits_is_refused(vehicle, text):
    with pytest.raises(TuneError, match=text):
        settings(scenario(), vehicle)


def test_behind_a_vehicle_without_lag_the_approach_is_the_time_base():
    """A velocity that is flown at once leaves the residual at the deadline, and nothing after it."""
    at_once = np.zeros(4000)
    at_once[0] = 1.0
    loop = LoopGain(10.0, 0.02, 1.0, 1.2, PROFILE_SOFT)
    t, left = approach(loop, at_once)
    assert left[0] == 1.0
    assert np.abs(left[t >= 10.0]).max() < 1e-6


def test_a_slower_vehicle_needs_a_later_deadline():
    quick, slow = (
        impulse_response(Identified(PX4.measured(None, lag_s), 1.0, 0.02, ()), lead=False)
        for lag_s in (0.1, 0.5)
    )
    loop = LoopGain(6.0, 0.05, 1.0, 0.5, PROFILE_SOFT)
    (t, best), (_, worst) = approach(loop, quick), approach(loop, slow)
    assert np.abs(best[t >= 6.0]).max() < np.abs(worst[t >= 6.0]).max()
