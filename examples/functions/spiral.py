"""A trajectory and a shape of one's own: `kind: spiral.py:spiral`, `kind: spiral.py:arc`."""

from math import cos, pi, sin


def spiral(t, radius_m=4.0, turn_s=40.0, climb_m_s=0.05):
    """Position x, y, z [m] of the leader at t [s] after the epoch."""
    angle = 2.0 * pi * t / turn_s
    radius = radius_m * (1.0 - 0.3 * sin(angle / 3.0))
    return radius * sin(angle), radius * cos(angle), 5.0 + climb_m_s * t


def arc(count, radius_m=2.5):
    """Places x, y, z [m] of so many UAVs, the leader's first: a half circle behind it."""
    angles = [pi * (k + 0.5) / (count - 1) for k in range(count - 1)]
    behind = [(-radius_m * sin(a), radius_m * cos(a), -0.3 * k) for k, a in enumerate(angles)]
    return [(0.0, 0.0, 0.0), *behind]
