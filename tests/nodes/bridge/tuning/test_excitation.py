"""The velocities of a hover test, and the response that is found in what was flown."""

import math

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from ptnsbc_nodes.bridge.tuning.excitation import Excitation, TuneError

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
