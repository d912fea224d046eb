"""A disturbance of one's own: air that rises around a place, with turbulence in it."""

import math

CENTRE_M, RADIUS_M, LIFT_M_S2, TURBULENCE_M_S2 = (0.0, 4.0), 3.0, 0.6, 0.2


def thermal(inputs):
    """Acceleration [m/s^2, ENU] and angular acceleration [rad/s^2] during one control period."""
    away = math.hypot(inputs.odometry[0] - CENTRE_M[0], inputs.odometry[1] - CENTRE_M[1])
    share = math.exp(-((away / RADIUS_M) ** 2))
    noise = TURBULENCE_M_S2 * share
    x, y, z = noise * inputs.samples[0], noise * inputs.samples[1], noise * inputs.samples[2]
    return x, y, z + LIFT_M_S2 * share, 0.0, 0.0, 0.0
