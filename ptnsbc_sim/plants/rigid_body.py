"""Plant `rigid_body_6dof`, (39)-(42) as corrected in docs/method.md: six inputs, Euler angles.

State (17,): position [m, ENU] 0:3, Euler angles roll pitch yaw [rad] 3:6, velocity [m/s, body FLU] 6:9, body
rates [rad/s] 9:12. Omega V_dot = tau - C V + G + Omega d, so forces include Coriolis terms and gravity. Drag, which
the paper does not have, is linear in the air speed, as of the quadrotor.
"""

from __future__ import annotations

import math

import numpy as np

from ptnsbc_core.algebra import store
from ptnsbc_core.kernel import inline_kernel
from ptnsbc_core.kinematics import quaternion_from_euler
from ptnsbc_core.types import Array
from ptnsbc_sim.plants.contract import STATE_SIZE, PlantConfig, Six, disturbance

_USED = 12
"""Entries of the state that this plant has."""


@inline_kernel
def derivative(x: Array, wrench: Array, push: Six, config: PlantConfig, out: Array) -> None:
    """x_dot into `out` (17,), for a wrench (6,) in body FLU and a disturbance acceleration `push` (6,)."""
    sf, cf = math.sin(x[3]), math.cos(x[3])
    st, ct = math.sin(x[4]), math.cos(x[4])
    sp, cp = math.sin(x[5]), math.cos(x[5])
    u, v, w = x[6], x[7], x[8]
    p, q, r = x[9], x[10], x[11]
    out[0] = cp * ct * u + (cp * st * sf - sp * cf) * v + (cp * st * cf + sp * sf) * w
    out[1] = sp * ct * u + (sp * st * sf + cp * cf) * v + (sp * st * cf - cp * sf) * w
    out[2] = -st * u + ct * sf * v + ct * cf * w
    turn = sf * q + cf * r
    out[3] = p + turn * st / ct
    out[4] = cf * q - sf * r
    out[5] = turn / ct
    m, g = config.mass, config.gravity
    out[6] = wrench[0] / m - (q * w - r * v) + g * st + push[0]
    out[7] = wrench[1] / m - (r * u - p * w) - g * ct * sf + push[1]
    out[8] = wrench[2] / m - (p * v - q * u) - g * ct * cf + push[2]
    if config.drag > 0.0:
        east, north, up = config.wind[0], config.wind[1], config.wind[2]
        air_u = cp * ct * east + sp * ct * north - st * up
        air_v = (cp * st * sf - sp * cf) * east + (sp * st * sf + cp * cf) * north + ct * sf * up
        air_w = (cp * st * cf + sp * sf) * east + (sp * st * cf - cp * sf) * north + ct * cf * up
        out[6] -= config.drag * (u - air_u)
        out[7] -= config.drag * (v - air_v)
        out[8] -= config.drag * (w - air_w)
    ix, iy, iz = config.inertia[0], config.inertia[1], config.inertia[2]
    out[9] = (wrench[3] + (iy - iz) * q * r) / ix + push[3]
    out[10] = (wrench[4] + (iz - ix) * r * p) / iy + push[4]
    out[11] = (wrench[5] + (ix - iy) * p * q) / iz + push[5]


@inline_kernel
def _ahead(x: Array, factor: float, slope: Array, out: Array) -> None:
    for i in range(_USED):
        out[i] = x[i] + factor * slope[i]


@inline_kernel
def advance(out: Array, wrench: Array, step_s: float, config: PlantConfig, sines: Array) -> None:
    """State `out` (17,), in place, by one control period; `sines` as in `Waves`."""
    slopes, mid = np.empty((4, STATE_SIZE)), np.empty(STATE_SIZE)
    now = disturbance(config, sines, 0)
    for n in range(sines.shape[0] // 2):
        middle, end = disturbance(config, sines, 2 * n + 1), disturbance(config, sines, 2 * n + 2)
        derivative(out, wrench, now, config, slopes[0])
        _ahead(out, 0.5 * step_s, slopes[0], mid)
        derivative(mid, wrench, middle, config, slopes[1])
        _ahead(out, 0.5 * step_s, slopes[1], mid)
        derivative(mid, wrench, middle, config, slopes[2])
        _ahead(out, step_s, slopes[2], mid)
        derivative(mid, wrench, end, config, slopes[3])
        for i in range(_USED):
            between = slopes[1, i] + slopes[2, i]
            out[i] += step_s / 6.0 * (slopes[0, i] + 2.0 * between + slopes[3, i])
        now = end


@inline_kernel
def store_odometry(out: Array, x: Array) -> None:
    """Odometry vector of a state (17,) into `out` (13,)."""
    store(out, 0, x[0:3])
    store(out, 3, quaternion_from_euler(x[3:6]))
    store(out, 7, x[6:12])
