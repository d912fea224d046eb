"""The `gains` block of a scenario file; its defaults are in defaults.py."""

from __future__ import annotations

from typing import Literal

from ptnsbc_sim.scenario.fields import Block, Flag, NotNegative, Positive, Residual

Profile = Literal["paper", "soft", "reference"]


class Loop(Block):
    """One loop: scale * (time-base gain + kappa * profile), or scale * kappa without a time base."""

    deadline_s: Positive
    """Of the loop, counted from the epoch."""
    residual: Residual
    """q: share of the start error that is left at the deadline."""
    scale: Positive
    """Λ, multiplies time base and κ."""
    kappa_1_s: NotNegative
    """κ: the gain that stays after the deadline."""
    profile: Profile | None = None
    """Overrides `gains.profile` in this loop."""
    time_base: Flag = True
    """False: without a time base the gain is `scale` times `kappa_1_s` from the first instant."""


class Estimator(Block):
    """The distributed estimator of the leader's state; k2 and boundary are per estimated unit."""

    deadline_s: Positive
    """Of the estimates."""
    residual: Residual
    """As in a loop."""
    k1_1_s: NotNegative
    """Linear gain."""
    k2: NotNegative
    """Gain of the saturated term, per estimated unit."""
    boundary: Positive
    """Width of the saturation, per estimated unit."""
    feed_forward: Flag
    """Feeds the estimated velocity forward."""
    time_base: Flag
    """False: the gain is `k1_1_s` from the first instant."""


class ClearanceGains(Loop):
    """Keeping clear of obstacles and of each other."""

    margin_m: NotNegative
    """Added to every keep-out."""
    circulation: NotNegative
    """Sideways speed per blocked speed."""
    ramp_s: Positive
    """Rise time of that."""
    timeout_s: Positive
    """Then the other side is tried."""
    forget_s: Positive
    """Quiet for so long: the encounter is over."""


class Filter(Block):
    """The command filter between the behaviours and the controller."""

    bandwidth_1_s: Positive
    """Of the velocity command."""
    rate_bandwidth_1_s: Positive
    """Of the body-rate command."""
    max_speed_m_s: Positive
    """Of the velocity command."""
    max_acceleration_m_s2: Positive
    """Of the velocity command."""
    max_rate_rad_s: Positive
    """Of the body-rate command."""
    max_rate_acceleration_rad_s2: Positive
    """Of the body-rate command."""


class Adaptation(Block):
    """The adaptive part of the controller."""

    gamma_mass: Positive
    """Γ of the mass."""
    gamma_inertia: Positive
    """Γ of the inertia."""
    upsilon: Positive
    """Υ of the bound on the disturbance."""
    mass_range: Residual
    """How far mass and inertia may be estimated from nominal, as a share."""
    leak_1_s: NotNegative
    """Lets the bound go down again."""
    dead_zone_m_s: NotNegative
    """Velocity error below which nothing is adapted."""
    dead_zone_rad_s: NotNegative
    """Likewise of the body rates."""
    cap_m_s2: NotNegative
    """Largest bound on a force per mass."""
    cap_rad_s2: NotNegative
    """Largest bound on a torque per inertia."""


class Boundary(Block):
    """Width of the saturation in the sliding-mode controller."""

    velocity_m_s: Positive
    """Of the velocity loop."""
    rate_rad_s: Positive
    """Of the body-rate loop."""


class Pointing(Block):
    """The quadrotor's loop from desired thrust direction and yaw to body rates."""

    tilt_1_s: Positive
    """Of the thrust direction."""
    yaw_1_s: Positive
    """Of the heading."""


class ObserverGains(Block):
    """Disturbance observer of the quadrotor's velocity loop; 0 switches it off."""

    bandwidth_1_s: NotNegative
    """Of the disturbance observer, quadrotor; 0 switches it off."""


class Damping(Block):
    """Damping of the task pseudo-inverse near a singularity."""

    threshold: Positive
    """Singular value below which the task is damped."""
    maximum: NotNegative
    """Damping at a singular value of zero."""


class Hold(Block):
    """What a UAV does when it holds or lands."""

    gain_1_s: Positive
    """Of the place that is held."""
    land_speed_m_s: Positive
    """Of the descent."""


class Gains(Block):
    """Every gain of the laws."""

    profile: Profile
    """See [method.md](method.md#time-base-1215)."""
    formation: Loop
    """Loop of leader tracking and formation."""
    attitude: Loop
    """Loop of the attitude, six-input plant."""
    estimator: Estimator
    """Estimator of the leader's state."""
    force: Loop
    """Velocity loop."""
    torque: Loop
    """Body-rate loop."""
    clearance: ClearanceGains
    """Loop of keeping clear; counts from the start of each encounter."""
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
    """What holds and lands."""
