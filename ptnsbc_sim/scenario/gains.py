"""The `gains` block of a scenario file; its defaults are in defaults.py."""

from __future__ import annotations

import math
from typing import Literal

from ptnsbc_core.types import PROFILES, LoopGain
from ptnsbc_sim.scenario.fields import Block, Flag, NotNegative, Positive, Residual

Profile = Literal["paper", "soft", "reference"]


class Loop(Block):
    """One loop: scale * (time-base gain + kappa * profile), or scale * kappa without a time base."""

    deadline_s: Positive
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
    """Clearance from obstacles and from other UAVs."""

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
    """Estimator of the leader's state."""
    force: Loop
    """Velocity loop."""
    torque: Loop
    """Body-rate loop."""
    clearance: ClearanceGains
    """Loop of the clearance; its deadline counts from the start of each encounter."""
    filter: Filter
    """Command filter."""
    adaptation: Adaptation
    """Adaptive part of the controller."""
    boundary: Boundary
    """Width of the saturation in the controller."""
    pointing: Pointing
    """From thrust direction and heading to body rates, quadrotor."""
    observer: ObserverGains
    """Disturbance observer."""
    damping: Damping
    """Damping near a singularity."""
    hold: Hold
    """Holding a position and landing."""


def gain_of(gains: Gains, loop: Loop) -> LoopGain:
    """A loop's gains; where the profile of all loops is `paper`, Lambda and kappa are 1 as printed.

    Without a time base the gain is constant from the first instant: h_dot / (1 - h + inf) is 0, and c is 1.
    """
    if not loop.time_base:
        return LoopGain(
            duration_s=float(loop.deadline_s),
            residual=math.inf,
            scale=float(loop.scale),
            kappa=float(loop.kappa_1_s),
            profile=PROFILES["paper"],
        )
    printed = loop.profile is None and gains.profile == "paper"
    return LoopGain(
        duration_s=float(loop.deadline_s),
        residual=float(loop.residual),
        scale=1.0 if printed else float(loop.scale),
        kappa=1.0 if printed else float(loop.kappa_1_s),
        profile=PROFILES[loop.profile or gains.profile],
    )
