"""How the stand-ins follow a velocity setpoint, beside what was measured on PX4 and ArduCopter: docs/autopilot.md."""

import math

import numpy as np
import pytest

from ptnsbc_autopilot.firmware.arducopter import GUIDED, ArduCopter
from ptnsbc_autopilot.firmware.px4 import Px4
from ptnsbc_io.mavlink.dialect import mavlink

STEP_S, SENT_EVERY = 0.01, 2
AMPLITUDE_M_S = 0.5  # ArduCopter's jerk at 0.5 Hz is then just within its limit
VELOCITY, VELOCITY_ACCELERATION = 0x09C7, 0x0807
TOLERANCE = 0.15

# (gain, lag [s]) at 0.1, 0.25 and 0.5 Hz; gain with exact acceleration at 0.25 and 0.5 Hz; 63 % of a step [s]
MEASURED = {
    ArduCopter: (((0.98, 0.52), (1.10, 0.47), (0.85, 0.63)), (1.40, 1.60), 0.82),
    Px4: (((0.67, 0.59), (0.59, 0.48), (0.44, 0.40)), (0.73, 0.90), 0.97),
}


class Flight:
    """One vehicle in the air that gets a velocity to the east, without sockets."""

    def __init__(self, companion, kind):
        made = companion(kind)
        if kind is Px4:
            made.airborne()
        else:
            for command in (
                (mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED),
                (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1),
                (mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0),
            ):
                assert made.command(*command) == 0
            made.run(8.0)
        self.vehicle, self.t = made.vehicle, made.t

    def follow(self, speed, seconds, acceleration=None):
        """Times [s] from now and true speeds [m/s] while `speed(time)` is commanded."""
        rows = []
        for n in range(round(seconds / STEP_S)):
            at = n * STEP_S
            if n % SENT_EVERY == 0:
                push = 0.0 if acceleration is None else acceleration(at)
                mask = VELOCITY if acceleration is None else VELOCITY_ACCELERATION
                vectors = (0, 0, 0, 0, speed(at), 0, 0, push, 0)
                message = mavlink.MAVLink_set_position_target_local_ned_message(
                    0, 1, 1, mavlink.MAV_FRAME_LOCAL_NED, mask, *vectors, 0, 0
                )
                self.vehicle.on_setpoint(message, self.t + at)
            self.vehicle.step(self.t + at + STEP_S)
            rows.append((at + STEP_S, self.vehicle.flight.truth.velocity_enu[0]))
        self.t += seconds
        return np.array(rows).T

    def response(self, hertz, exact=False):
        """Gain and lag [s] at one frequency, from the last two of five periods."""
        rate = 2.0 * math.pi * hertz
        acceleration = (lambda at: AMPLITUDE_M_S * rate * math.cos(rate * at)) if exact else None
        seconds = 5.0 / hertz
        t, v = self.follow(lambda at: AMPLITUDE_M_S * math.sin(rate * at), seconds, acceleration)
        late = t > 3.0 / hertz
        t, v = t[late], v[late]
        waves = np.stack((np.sin(rate * t), np.cos(rate * t), np.ones_like(t)), axis=1)
        (s, c, _), *_ = np.linalg.lstsq(waves, v, rcond=None)
        return math.hypot(s, c) / AMPLITUDE_M_S, -math.atan2(c, s) / rate

    def step_s(self):
        """Time [s] to 63 % of a step from rest."""
        self.follow(lambda _: 0.0, 8.0)
        t, v = self.follow(lambda _: 1.0, 4.0)
        return float(t[np.argmax(v >= 0.63)])


@pytest.mark.slow
@pytest.mark.parametrize("kind", MEASURED)
def test_it_follows_velocities_as_the_real_one_does(companion, kind):
    at, exact, step_s = MEASURED[kind]
    flight = Flight(companion, kind)
    found = [flight.response(hertz) for hertz in (0.1, 0.25, 0.5)]
    assert [gain for gain, _ in found] == pytest.approx([g for g, _ in at], rel=TOLERANCE)
    assert [lag for _, lag in found] == pytest.approx([lag for _, lag in at], rel=TOLERANCE)
    gains = [flight.response(hertz, exact=True)[0] for hertz in (0.25, 0.5)]
    assert gains == pytest.approx(exact, rel=TOLERANCE)
    assert flight.step_s() == pytest.approx(step_s, rel=TOLERANCE)
