"""A controller of one's own: proportional gains instead of the adaptive law, for thrust and torque."""

import numpy as np

VELOCITY_1_S, TILT_1_S2, RATE_1_S, YAW_1_S = 8.0, 200.0, 25.0, 8.0


def proportional(inputs):
    """Force [N] and torque [N m] of a quadrotor that turns its thrust towards the wanted acceleration."""
    x, y, z, w = inputs.odometry[3:7]
    turn = np.array(  # body to world
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    body_velocity, rates = inputs.odometry[7:10], inputs.odometry[10:13]
    velocity = np.array([np.sum(turn[k] * body_velocity) for k in range(3)])
    wanted = VELOCITY_1_S * (inputs.velocity - velocity)
    wanted[2] += inputs.gravity
    ahead = np.array([np.sum(turn[:, k] * wanted) for k in range(3)])  # in the body
    thrust = inputs.mass * max(ahead[2], 0.3 * inputs.gravity)
    tilt = np.array([-ahead[1], ahead[0], 0.0]) / max(np.sqrt(np.sum(wanted * wanted)), 1.0)
    turning = TILT_1_S2 * tilt - RATE_1_S * rates
    turning[2] = YAW_1_S * (inputs.yaw_rate - rates[2])
    torque = inputs.inertia * turning
    return 0.0, 0.0, thrust, torque[0], torque[1], torque[2]
