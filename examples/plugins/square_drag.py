"""A plant of one's own: a quadrotor whose drag grows with the square of the air speed."""

import math

import numpy as np

DRAG_1_M = 0.05


def square_drag(inputs):
    """d state / dt of position, quaternion, velocity, body rates, thrust and torques."""
    state, wrench, rate = inputs.state, inputs.wrench, 1.0 / inputs.motor_lag_s
    a, b, c, d = state[3:7]
    p, q, r = state[10:13]
    air = state[7:10] - inputs.wind
    drag = DRAG_1_M * math.sqrt(np.sum(air * air)) * air
    lift = state[13] / inputs.mass
    up = np.array([2 * (a * c + d * b), 2 * (b * c - d * a), 1 - 2 * (a * a + b * b)])
    ix, iy, iz = inputs.inertia
    gyro = np.array([(iy - iz) * q * r, (iz - ix) * r * p, (ix - iy) * p * q])
    out = np.zeros(17)
    out[0:3] = state[7:10]
    out[3:7] = 0.5 * np.array(
        [
            d * p + b * r - c * q,
            d * q + c * p - a * r,
            d * r + a * q - b * p,
            -a * p - b * q - c * r,
        ]
    )
    out[7:10] = lift * up - drag + inputs.push[0:3]
    out[9] -= inputs.gravity
    out[10:13] = (state[14:17] + gyro) / inputs.inertia + inputs.push[3:6]
    out[13] = rate * (min(max(wrench[2], 0.0), inputs.max_thrust) - state[13])
    for k in range(3):
        most = inputs.max_torque[k]
        out[14 + k] = rate * (min(max(wrench[3 + k], -most), most) - state[14 + k])
    return out
