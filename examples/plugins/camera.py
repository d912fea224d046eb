"""A near-object sensor of one's own: a camera that looks forward and sees only what is in its field of view."""

import math

import numpy as np

HALF_ANGLE_RAD = math.radians(60.0)


def camera(inputs):
    """Rows x y z [m], keep-out [m], vx vy vz [m/s] of what is in range and in view."""
    x, y, z, w = inputs.odometry[3:7]
    heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    seen = np.zeros(len(inputs.objects), dtype=np.bool_)
    for k in range(len(inputs.objects)):
        away = inputs.objects[k, :3] - inputs.odometry[:3]
        turn = math.atan2(away[1], away[0]) - heading
        off_axis = abs(math.atan2(math.sin(turn), math.cos(turn)))
        near = math.sqrt(np.sum(away * away)) <= inputs.range_m
        seen[k] = near and off_axis <= HALF_ANGLE_RAD
    return inputs.objects[seen]
