"""The `gains` block of a scenario file, and the default of each gain: one table for both plants, one for each plant.

The keys of a scenario file take precedence, key by key. Only `gains.formation.deadline_s` has no default: it is
what a scenario promises. A loop without a `profile` uses `gains.profile`.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import WrapValidator

from ptnsbc_core.types import PROFILES, LoopGain
from ptnsbc_sim.scenario.fields import AUTO, Block, Flag, NotNegative, Positive, Residual

Profile = Literal["paper", "soft", "reference"]


Deadline = Annotated[
    Positive, WrapValidator(lambda value, check: math.inf if value == AUTO else check(value))
]
"""A deadline; the one that is left to us is infinite until it is known."""


class Loop(Block):
    """One loop: scale * (time-base gain + kappa * profile), or scale * kappa without a time base."""

    deadline_s: Deadline
    """Deadline of the loop, counted from the epoch. `gains.formation` also takes `auto`: 1.5 times the shortest
    deadline that the limits allow from the starts of the file to their places, or with `assignment: optimal` to the
    slots that these starts are given; the scenario in a bag has the number."""
    residual: Residual
    """q: fraction of the start error that remains at the deadline."""
    scale: Positive
    """Λ: factor of the whole gain, of time base and κ."""
    kappa_1_s: NotNegative
    """κ: constant part of the gain, which acts after the deadline too."""
    profile: Profile | None = None
    """Profile of this loop, in place of `gains.profile`."""
    time_base: Flag = True
    """False: the loop has no time base, and its gain is always `scale` times `kappa_1_s`."""


class Estimator(Block):
    """The distributed estimator of the leader's state; k2 and boundary are per estimated unit."""

    deadline_s: Positive
    """Deadline of the estimates."""
    residual: Residual
    """q: fraction of the start error that remains at the deadline."""
    k1_1_s: NotNegative
    """Linear gain."""
    k2: NotNegative
    """Gain of the saturated term, per estimated unit."""
    boundary: Positive
    """Width of the saturation, per estimated unit."""
    feed_forward: Flag
    """True if the estimated velocity is fed forward to the estimated position."""
    time_base: Flag
    """False: the estimator has no time base, and its gain is always `k1_1_s`."""


class ClearanceGains(Loop):
    """Clearance from obstacles and other UAVs; its deadline counts from the start of each encounter."""

    margin_m: NotNegative
    """Distance added to every keep-out radius."""
    circulation: NotNegative
    """Tangential speed per blocked speed."""
    ramp_s: Positive
    """Rise time of the tangential speed."""
    timeout_s: Positive
    """Duration of an encounter after which the other side is tried."""
    forget_s: Positive
    """An encounter ends when the object has not restricted the velocity for this long."""
    approach: Literal["braking", "linear"]
    """Closing speed that the room allows: what the vehicle can brake, or `linear`, κ times the room, as in (36)."""
    lag_s: Positive | None = None
    """Lag with which the vehicle follows the filtered velocity. Default: the sum of the lags of the plant's loops."""
    stale_s: Positive
    """A UAV whose near-object sensor has been silent for this long slows down."""
    deadlock_s: Positive
    """A UAV to which avoidance has left no way to its place for this long is in a deadlock."""


class Filter(Block):
    """The command filter between the behaviours and the controller."""

    bandwidth_1_s: Positive
    """Bandwidth of the velocity command."""
    rate_bandwidth_1_s: Positive
    """Bandwidth of the body-rate command."""
    max_speed_m_s: Positive
    """Largest velocity command."""
    max_acceleration_m_s2: Positive
    """Largest rate of change of the velocity command."""
    max_rate_rad_s: Positive
    """Largest body-rate command."""
    max_rate_acceleration_rad_s2: Positive
    """Largest rate of change of the body-rate command."""


class Adaptation(Block):
    """The adaptive part of the controller."""

    gamma_mass: Positive
    """Γ: inverse adaptation rate of the mass."""
    gamma_inertia: Positive
    """Γ: inverse adaptation rate of the inertia."""
    upsilon: Positive
    """Υ: inverse adaptation rate of the disturbance bound."""
    mass_range: Residual
    """Largest deviation of estimated mass and inertia from nominal, as a fraction."""
    leak_1_s: NotNegative
    """Rate at which the disturbance bound decays."""
    dead_zone_m_s: NotNegative
    """Velocity error below which the force bound does not grow."""
    dead_zone_rad_s: NotNegative
    """Body-rate error below which the torque bound does not grow."""
    cap_m_s2: NotNegative
    """Largest force bound, per unit of mass."""
    cap_rad_s2: NotNegative
    """Largest torque bound, per unit of inertia."""


class Boundary(Block):
    """Width of the saturation in the sliding-mode controller."""

    velocity_m_s: Positive
    """Width in the velocity loop."""
    rate_rad_s: Positive
    """Width in the body-rate loop."""


class Pointing(Block):
    """The quadrotor's loop from desired thrust direction and yaw to body rates."""

    tilt_1_s: Positive
    """Gain of the thrust direction."""
    yaw_1_s: Positive
    """Gain of the heading."""


class ObserverGains(Block):
    """Disturbance observer of the quadrotor's velocity loop; 0 switches it off."""

    bandwidth_1_s: NotNegative
    """Bandwidth of the disturbance observer, quadrotor; 0 switches it off."""


class Damping(Block):
    """Damping of the task pseudo-inverse near a singularity."""

    threshold: Positive
    """Singular value below which the task is damped."""
    maximum: NotNegative
    """Damping at a singular value of zero."""


class Hold(Block):
    """Holding a position and landing."""

    gain_1_s: Positive
    """Gain on the distance from the position that is held."""
    land_speed_m_s: Positive
    """Descent speed."""


class Gains(Block):
    """All gains of the laws."""

    profile: Profile
    """The start of the gains at the epoch, see [method.md](method.md#time-base-1215)."""
    formation: Loop
    """Loop of leader tracking and formation."""
    attitude: Loop
    """Loop of the attitude, plant with six inputs."""
    estimator: Estimator
    force: Loop
    """Velocity loop."""
    torque: Loop
    """Body-rate loop."""
    clearance: ClearanceGains
    filter: Filter
    adaptation: Adaptation
    boundary: Boundary
    pointing: Pointing
    observer: ObserverGains
    damping: Damping
    hold: Hold


def gain_of(gains: Gains, loop: Loop) -> LoopGain:
    """A loop's gains; where the profile of all loops is `paper`, Lambda and kappa are 1 as printed.

    Without a time base the gain is constant from the first instant: h_dot / (1 - h + inf) is 0, and c is 1.
    """
    printed = loop.time_base and loop.profile is None and gains.profile == "paper"
    profile = (loop.profile or gains.profile) if loop.time_base else "paper"
    return LoopGain(
        duration_s=float(loop.deadline_s),
        residual=float(loop.residual) if loop.time_base else math.inf,
        scale=1.0 if printed else float(loop.scale),
        kappa=1.0 if printed else float(loop.kappa_1_s),
        profile=PROFILES[profile],
    )


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
        # wide boundaries and low caps: the sliding term adds cap/boundary to a loop gain
        "adaptation": {"gamma_mass": 12, "cap_m_s2": 1, "cap_rad_s2": 3},
        "boundary": {"velocity_m_s": 0.4, "rate_rad_s": 1.0},
    },
}


_DEFAULTS = {
    plant: _COMMON | {key: _COMMON.get(key, {}) | own[key] for key in own}
    for plant, own in _PLANT.items()
}


def gain_defaults(plant: str) -> dict[str, Any]:
    """The default `gains` block of a plant kind; not to be changed."""
    return _DEFAULTS.get(plant, _DEFAULTS["quadrotor"])
