"""Default gains: one table for both plants, and one for each plant with what differs.

The keys of a scenario file take precedence, key by key. Only `gains.formation.deadline_s` has no default: it is
what a scenario promises. A loop without a `profile` uses `gains.profile`.
"""

from __future__ import annotations

import pickle
from functools import cache
from typing import Any

from ptnsbc_sim.scenario.reading.reader import merged

_COMMON: dict[str, Any] = {
    "profile": "soft",  # no input step at t = 0
    "formation": {"residual": 2e-2, "scale": 1, "kappa_1_s": 2.2},
    "attitude": {"deadline_s": 1.5, "residual": 1e-3, "scale": 1, "kappa_1_s": 1},
    # k2 exceeds any rate of change of the leader; the boundary keeps dt k2/boundary small
    "estimator": {
        "deadline_s": 1.5,
        "residual": 1e-2,
        "k1_1_s": 10,  # a slower estimate lags the climbing leader by decimetres
        "k2": 3.5,
        "boundary": 1.2,
        "feed_forward": True,
        "time_base": True,
    },
    # An encounter is short: a coarse residual is reached at the edge of the keep-out already.
    "clearance": {
        "deadline_s": 1,
        "residual": 1e-2,
        "scale": 1,
        "kappa_1_s": 3,  # closing speed per metre of room: 1.5 m/s at half a metre
        "margin_m": 0.02,  # the velocity loop lags: without it a keep-out is grazed by a millimetre
        "circulation": 0.6,  # of the blocked speed, sideways: leaves a dead end
        "ramp_s": 0.5,  # a step in velocity would only saturate the command filter
        "timeout_s": 8,  # longer than passing any keep-out sphere of the shipped scenarios takes
        "forget_s": 1,
        "approach": "braking",  # linear asks for three times the speed as braking, whatever there is
        "stale_s": 0.5,  # as the links: ten periods of the sensor of the shipped scenarios
        "deadlock_s": 4,  # nobody who came through in 480 drawn flights stood still for 2.5 s
    },
    "filter": {
        "bandwidth_1_s": 20,  # well above the formation loop at its peak
        "rate_bandwidth_1_s": 50,  # half the control rate: the attitude loop has no time to lose
        "max_speed_m_s": 8,
        "max_acceleration_m_s2": 10,  # about tan(40 deg) g
        "max_rate_rad_s": 12,
        "max_rate_acceleration_rad_s2": 200,
    },
    # Table 1 of the paper: Gamma = 2.5 and Upsilon = 0.4, applied as their inverses
    "adaptation": {
        "gamma_mass": 2.5,
        "gamma_inertia": 2.5,
        "upsilon": 0.4,
        "mass_range": 0.3,  # a battery or a small payload more or less
        "leak_1_s": 0.1,  # without it the bound grows for ever
        "dead_zone_m_s": 0.01,
        "dead_zone_rad_s": 0.02,
        "cap_m_s2": 2,  # twice the disturbances of Table 2
        "cap_rad_s2": 5,
    },
    "boundary": {"velocity_m_s": 0.05, "rate_rad_s": 0.1},
    "pointing": {"tilt_1_s": 12, "yaw_1_s": 3},  # below the body-rate loop, above the velocity loop
    "observer": {"bandwidth_1_s": 6},  # between the disturbances (1 rad/s) and the attitude loop
    # metres per metre: the shipped formations stay above the threshold, Table 2 starts below it
    "damping": {"threshold": 0.35, "maximum": 0.5},
    "hold": {"gain_1_s": 1, "land_speed_m_s": 0.5},
}

_PLANT: dict[str, dict[str, Any]] = {
    # Forces and torques act at once: both inner loops can be as fast as the control rate allows.
    "rigid_body_6dof": {
        "force": {"deadline_s": 1, "residual": 1e-3, "scale": 1, "kappa_1_s": 25},
        "torque": {"deadline_s": 1, "residual": 1e-3, "scale": 1, "kappa_1_s": 15},
    },
    # Thrust follows the attitude and the attitude follows the rates, each about three times as fast
    # as the loop around it. Found by a search that flew every candidate once as it is and once with
    # the wrench one control period late, as a slow host delivers it.
    "quadrotor": {
        # firm from the start: the error at t = 0 is zero, and a vehicle that starts tilted falls
        "force": {
            "deadline_s": 1.5,
            "residual": 0.5,
            "scale": 1,
            "kappa_1_s": 5.5,
            "profile": "paper",
        },
        "torque": {
            "deadline_s": 0.5,
            "residual": 0.3,
            "scale": 1,
            "kappa_1_s": 32,
            "profile": "paper",
        },
        "filter": {"bandwidth_1_s": 30, "max_rate_rad_s": 6.5},
        "pointing": {"tilt_1_s": 12, "yaw_1_s": 3},
        # wide boundaries and low caps: the sliding term adds cap/boundary to a loop gain
        "adaptation": {"gamma_mass": 12, "cap_m_s2": 1, "cap_rad_s2": 3},
        "boundary": {"velocity_m_s": 0.4, "rate_rad_s": 1.0},
    },
}


def gain_defaults(plant: str) -> dict[str, Any]:
    """The default `gains` block of a plant kind, a fresh copy."""
    fresh: dict[str, Any] = pickle.loads(_pickled(plant if plant in _PLANT else "quadrotor"))
    return fresh


@cache
def _pickled(plant: str) -> bytes:
    """The defaults as bytes: loading them is a tenth of the work of copying them."""
    return pickle.dumps(merged(_COMMON, _PLANT[plant]))
