"""The `gains` block of a scenario file; its defaults are in defaults.py."""

from __future__ import annotations

from typing import Literal

from ptnsbc_sim.scenario.fields import Block, Flag, NotNegative, Positive, Residual

Profile = Literal["paper", "soft", "reference"]


class Loop(Block):
    """One loop: scale * (time-base gain + kappa * profile), or scale * kappa without a time base."""

    deadline_s: Positive
    residual: Residual
    scale: Positive
    kappa_1_s: NotNegative
    profile: Profile | None = None
    time_base: Flag = True


class Estimator(Block):
    """The distributed estimator of the leader's state; k2 and boundary are per estimated unit."""

    deadline_s: Positive
    residual: Residual
    k1_1_s: NotNegative
    k2: NotNegative
    boundary: Positive
    feed_forward: Flag
    time_base: Flag


class Clearance(Loop):
    """Keeping clear of obstacles and of each other."""

    margin_m: NotNegative
    circulation: NotNegative
    ramp_s: Positive
    timeout_s: Positive
    forget_s: Positive


class Filter(Block):
    """The command filter between the behaviours and the controller."""

    bandwidth_1_s: Positive
    rate_bandwidth_1_s: Positive
    max_speed_m_s: Positive
    max_acceleration_m_s2: Positive
    max_rate_rad_s: Positive
    max_rate_acceleration_rad_s2: Positive


class Adaptation(Block):
    """The adaptive part of the controller."""

    gamma_mass: Positive
    gamma_inertia: Positive
    upsilon: Positive
    mass_range: Residual
    leak_1_s: NotNegative
    dead_zone_m_s: NotNegative
    dead_zone_rad_s: NotNegative
    cap_m_s2: NotNegative
    cap_rad_s2: NotNegative


class Boundary(Block):
    """Width of the saturation in the sliding-mode controller."""

    velocity_m_s: Positive
    rate_rad_s: Positive


class Pointing(Block):
    """The quadrotor's loop from desired thrust direction and yaw to body rates."""

    tilt_1_s: Positive
    yaw_1_s: Positive


class Observer(Block):
    """Disturbance observer of the quadrotor's velocity loop; 0 switches it off."""

    bandwidth_1_s: NotNegative


class Damping(Block):
    """Damping of the task pseudo-inverse near a singularity."""

    threshold: Positive
    maximum: NotNegative


class Hold(Block):
    """What a UAV does when it holds or lands."""

    gain_1_s: Positive
    land_speed_m_s: Positive


class Gains(Block):
    """Every gain of the laws."""

    profile: Profile
    formation: Loop
    attitude: Loop
    estimator: Estimator
    force: Loop
    torque: Loop
    clearance: Clearance
    filter: Filter
    adaptation: Adaptation
    boundary: Boundary
    pointing: Pointing
    observer: Observer
    damping: Damping
    hold: Hold
