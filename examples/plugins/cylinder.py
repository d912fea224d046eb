"""A task of one's own: the place beside the parent in cylinder coordinates, distance, bearing and height."""

import math


def cylinder(own, parent, reference):
    """Distance [m], bearing from east [rad] and height [m] of this UAV beside its parent."""
    x, y, z = own[0] - parent[0], own[1] - parent[1], own[2] - parent[2]
    return math.hypot(x, y), math.atan2(y, x), z


cylinder.angles = (1,)  # the bearing: its error is wrapped
