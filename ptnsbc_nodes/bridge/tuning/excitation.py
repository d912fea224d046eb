"""The velocities of a hover test: sinusoids of known frequency within a box, and what the vehicle made of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array

SETTLE_S = 4.0
_TONES = (
    (0.1, 3),
    (0.25, 4),
    (0.5, 6),
)  # [Hz], and periods; the first period of each is not evaluated
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

    @property
    def evaluated_s(self) -> float:
        """From where on it counts: the vehicle swings in before."""
        return self.begin_s + 1.0 / self.hertz


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
        self.box_m = box_m
        self.tones = tuple(self._tones(box_m))
        slowest = self.tones[0]
        if slowest.amplitude_m_s < _LEAST_M_S:
            least_m = 2.0 * _LEAST_M_S / (_SHARE * 2.0 * math.pi * slowest.hertz)
            raise TuneError(
                f"--box {box_m:g}: expected at least {math.ceil(10 * least_m) / 10:g} m"
            )
        self.end_s = self.tones[-1].end_s

    @staticmethod
    def _tones(box_m: float) -> Sequence[Tone]:
        found, at_s = [], SETTLE_S
        for hertz, periods in _TONES:
            room_m_s = _SHARE * 0.5 * box_m * 2.0 * math.pi * hertz
            found.append(Tone(hertz, min(_MOST_M_S, room_m_s), at_s, at_s + periods / hertz))
            at_s += periods / hertz
        return found

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
        """The response at each frequency.

        Args:
            sent: (N, 2) time since the start [s] and velocity along x [m/s] of each setpoint.
            flown: (M, 2) the same of each state of the vehicle.

        Raises:
            TuneError: the vehicle moved too much by itself.
        """
        return [_point(tone, sent, flown) for tone in self.tones]


def _point(tone: Tone, sent: Array, flown: Array) -> FrequencyPoint:
    given, made = _phasor(tone, sent), _phasor(tone, flown)
    if made.rest_m_s > _NOISE * abs(made.value):
        raise TuneError(
            f"at {tone.hertz:g} Hz the vehicle flew {abs(made.value):.2f} m/s, and {made.rest_m_s:.2f} m/s that were "
            f"not asked for: expected at most {_NOISE:.0%}; fly in less wind, or with a larger --box"
        )
    return FrequencyPoint(tone.hertz, made.value / given.value)


class _Phasor(NamedTuple):
    value: complex
    rest_m_s: float  # root of the mean square of what is left


def _phasor(tone: Tone, rows: Array) -> _Phasor:
    """Least squares of a sinusoid beside a constant and a drift."""
    rows = rows[(rows[:, 0] >= tone.evaluated_s) & (rows[:, 0] < tone.end_s)]
    if len(rows) < _LEAST_SAMPLES:
        raise TuneError(
            f"{len(rows)} samples at {tone.hertz:g} Hz: expected at least {_LEAST_SAMPLES}; see the link to the vehicle"
        )
    t = rows[:, 0]
    phase = 2.0 * math.pi * tone.hertz * t
    waves = np.stack((np.cos(phase), np.sin(phase), np.ones_like(t), t - t.mean()), axis=1)
    parts, *_ = np.linalg.lstsq(waves, rows[:, 1], rcond=None)
    rest = math.sqrt(float(np.mean((rows[:, 1] - waves @ parts) ** 2)))
    return _Phasor(complex(parts[0], -parts[1]), rest)
