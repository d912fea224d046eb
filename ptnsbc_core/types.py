"""Input and output of one control step of one UAV.

An *odometry vector* (13,) float64 is the content of a nav_msgs/Odometry: position x y z [m, ENU] |
quaternion x y z w (body FLU to world ENU) | linear velocity [m/s] | angular velocity [rad/s]. Velocities are
in the body frame (REP-105 child frame), except in a leader estimate, where they are in the world frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Inside the kernels a vector is three numbers. An array lives on the heap and is reference-counted, which took three
# quarters of a step.
Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]  # rows
Vector3Like = Array | Vector3
Vector2 = tuple[float, float]

ODOMETRY_SIZE = 13
Odometry = tuple[float, ...]  # the 13 numbers of an odometry vector
OdometryLike = Array | Odometry
NEAR_COLUMNS = 8

# Gain profiles (docs/method.md): the c(t) of G(t) = Lambda (Xi(t) + kappa c(t))
PROFILE_PAPER, PROFILE_SOFT, PROFILE_REFERENCE = 0, 1, 2
PROFILES = {"paper": PROFILE_PAPER, "soft": PROFILE_SOFT, "reference": PROFILE_REFERENCE}

TASK_OWN = -1
"""A task of the user, see `ptnsbc_core.step.step`."""

APPROACH_TASK, APPROACH_PLANNED = 0, 1
APPROACHES = {"task": APPROACH_TASK, "planned": APPROACH_PLANNED}

AVOIDANCE_OFF, AVOIDANCE_SET_BASED, AVOIDANCE_SWITCHED = 0, 1, 2
AVOIDANCE = {"off": AVOIDANCE_OFF, "set_based": AVOIDANCE_SET_BASED, "switched": AVOIDANCE_SWITCHED}

SPEED_LINEAR, SPEED_BRAKING = 0, 1
APPROACH_SPEEDS = {"linear": SPEED_LINEAR, "braking": SPEED_BRAKING}

PLANT_RIGID_BODY, PLANT_QUADROTOR = 0, 1
PLANTS = {"rigid_body_6dof": PLANT_RIGID_BODY, "quadrotor": PLANT_QUADROTOR}

MODE_FORMATION, MODE_HOLD, MODE_LAND = 0, 1, 2
LEGS = {"form": MODE_FORMATION, "hold": MODE_HOLD, "land": MODE_LAND}

TRAJECTORY_CIRCLE, TRAJECTORY_LINE, TRAJECTORY_HARMONIC, TRAJECTORY_PIECEWISE = 0, 1, 2, 3

HEADING_FIXED, HEADING_PATH, HEADING_TABLE = 0, 1, 2

NEVER_RECEIVED_S = 1e9
"""Age of a neighbour from which nothing has been received yet [s]."""


class Estimate(NamedTuple):
    """Estimated state of the leader, world ENU; also the difference of two."""

    position: Vector3  # [m]
    velocity: Vector3  # [m/s]
    yaw: float  # [rad]


class PoseTarget(NamedTuple):
    """Position and heading to hold, world ENU."""

    position: Vector3  # [m]
    yaw: float  # [rad]


class InertialParameters(NamedTuple):
    """Psi of (49), of a body whose axes are its principal ones."""

    mass: float  # [kg]
    inertia: Vector3  # [kg m^2]


class DisturbanceObserver(NamedTuple):
    """Disturbance observer, world ENU."""

    velocity: Vector3  # [m/s] estimate after the last measurement
    disturbance: Vector3  # [m/s^2]
    acceleration: Vector3  # [m/s^2] that the last command gives by the model
    trend: Vector3  # [m/s^3] of the disturbance


class AdaptationState(NamedTuple):
    """Adaptive part of the controller's state."""

    parameters: InertialParameters  # Psi_hat
    bound: Vector2  # delta_hat of force [m/s^2] and torque [rad/s^2]
    observer: DisturbanceObserver


class LoopGain(NamedTuple):
    """G(t) = Lambda (Xi(t; tf, q) + kappa c(t)) [1/s]."""

    duration_s: float  # tf [s]
    residual: float  # q, 0 < q < 1
    scale: float  # Lambda
    kappa: float  # [1/s]
    profile: int  # PROFILE_*


class EstimatorConfig(NamedTuple):
    """Leader estimator (44)-(48) as corrected in docs/method.md."""

    duration_s: float  # tf2 [s]
    residual: float  # q2
    lambda_min: float  # smallest eigenvalue of H; the gain is Xi / lambda_min
    k1: float  # [1/s]
    k2: float  # [unit/s], bound on the leader's rate of change
    boundary: float  # width of the saturation, [unit of the estimated quantity]
    pinned: bool  # receives the leader's state
    feed_forward: bool  # add the estimated leader velocity


class VelocityLoop(NamedTuple):
    """The loops below the velocity: t v'' + v' = f u' + K (u - v), u the command after the filter."""

    gain: float  # K [1/s]
    attitude_s: float  # t
    fed_forward: float  # f: 1 where the rate of the command is fed forward, 0 where not


class ClearanceConfig(NamedTuple):
    """Obstacle and collision avoidance (33)-(38), docs/method.md."""

    rule: int  # AVOIDANCE_*
    margin_m: float  # added to the keep-out radius of every near object
    gain: LoopGain  # alpha; the time base counts from when a constraint begins to bind
    circulation: float  # tangential speed per blocked speed, 1
    ramp_s: float  # rise time of the circulation
    timeout_s: float  # after binding for longer than this the other side is tried
    forget_s: float  # an object that did not bind for longer than this is forgotten
    approach: int  # SPEED_*
    deceleration: float  # [m/s^2] that the vehicle has in every direction
    weakest: float  # [m/s^2] the same of the weakest vehicle of the fleet
    lag_s: float  # with which the vehicle follows a commanded velocity, the filter included
    bandwidth: float  # [1/s] of the command filter during an encounter
    loop: VelocityLoop
    sensor_s: float  # period of the near-object sensor
    stale_s: float  # a sensor that is silent for longer makes the UAV slow
    range_m: float  # of the sensor
    deadlock_s: float  # without a way to its place for longer a UAV is in a deadlock
    climb: float  # [m/s] of this UAV in a deadlock; all have another one


class RecoveryConfig(NamedTuple):
    """The return of a UAV to its place after an encounter, see behaviours/recovery.py."""

    least_s: float  # [s] shortest duration of the way back
    speed: float  # [m/s] that its plan may ask for, beside the leader's motion
    acceleration: float  # [m/s^2] likewise


class FilterConfig(NamedTuple):
    """Command filter, docs/method.md."""

    bandwidth: float  # [1/s], velocity
    rate_bandwidth: float  # [1/s], body rates
    max_speed: float  # [m/s]
    max_acceleration: float  # [m/s^2]
    max_rate: float  # [rad/s]
    max_rate_acceleration: float  # [rad/s^2]


class Trajectory(NamedTuple):
    """The leader's desired curve, see curves/trajectory.py."""

    numbers: tuple[float, ...]  # (8,) kind and its parameters
    table: Array  # (R, C) of the kinds that need one, else without rows


class Shape(NamedTuple):
    """The motion of the places of one UAV and its parent beside the leader, see curves/shape.py."""

    moving: bool
    turns: bool  # with the heading of the leader's trajectory
    table: Array  # (R, C) polynomials of the places; without rows when they stand still


class ControllerConfig(NamedTuple):
    """Sliding-mode controller (49)-(52) as corrected in docs/method.md."""

    plant: int  # PLANT_*
    gravity: float  # [m/s^2]
    nominal: InertialParameters  # Psi at the start, and Omega_0
    force: LoopGain  # velocity loop
    torque: LoopGain  # body-rate loop
    boundary: Vector2  # width of the saturation of the velocity [m/s] and of the rate error [rad/s]
    adaptation: Vector2  # 1/Gamma for mass and for inertia
    mass_range: float  # |m_hat - m| <= mass_range * m (the same for inertia)
    bound_rate: float  # 1/Upsilon
    bound_leak: float  # [1/s]
    bound_dead_zone: Vector2  # |error|_1 below which the bound does not grow [m/s], [rad/s]
    bound_cap: Vector2  # [m/s^2], [rad/s^2]
    observer_bandwidth: float  # [1/s] of the disturbance observer, quadrotor only; 0: off
    attitude_gain: Vector2  # tilt and yaw, quadrotor only [1/s]
    max_tilt: float  # [rad], quadrotor only
    max_thrust: float  # [N]
    max_torque: Vector3  # [N m]


class AgentConfig(NamedTuple):
    """Everything constant that one UAV needs."""

    leader: bool
    task: int  # number in tasks/table.py, or TASK_OWN
    approach: int  # APPROACH_*
    turn: float  # [rad] of the planned approach about the vertical, the same for all UAVs; 0: straight
    desired: Vector3  # desired task value sigma_d
    offset: Vector3  # [m, ENU] desired position relative to the parent
    slot: Vector3  # [m, ENU] desired position relative to the reference point of the formation
    leader_slot: Vector3  # [m, ENU] the leader's; not zero when another UAV took over in its slot
    slot_reach: float  # [m] half of the distance from the slot to the next one
    other_slots: Array  # (N - 1, 4) slots of the others, and their reach [m]
    anchor: Vector3  # [m, ENU] reference k = leader position + anchor (zero: the leader itself)
    row_scale: Vector3  # scaling of the task rows, so that every row is in metres
    formation: LoopGain  # also the leader's tracking loop
    attitude: LoopGain  # 6-DOF plant: Euler angles to their desired values
    damping_threshold: float  # singular value [1] below which the pseudo-inverse is damped
    damping_max: float  # largest damping factor
    estimator: EstimatorConfig
    clearance: ClearanceConfig
    recovery: RecoveryConfig
    filter: FilterConfig
    controller: ControllerConfig
    trajectory: Trajectory  # of the leader
    shape: Shape  # `offset` and `slot` count when it does not move
    association_gate_m: float  # within it a near object is taken to be parent or leader; 0: never
    stale_s: float  # the UAV holds when parent or leader are silent for longer
    hold_gain: float  # [1/s]
    land_speed: float  # [m/s]


class AgentInputs(NamedTuple):
    """The inputs of one UAV at this tick. Ages count from a message's stamp; NEVER_RECEIVED_S without a message."""

    own: OdometryLike  # (13,) odometry vector; kernels pass numbers, not arrays, which every write might change
    parent: OdometryLike  # (13,) odometry vector of the parent
    parent_age_s: float
    leader: OdometryLike  # (13,) odometry vector of the leader, for pinned followers
    leader_age_s: float
    estimates: Array  # (K, 13) leader estimates of the neighbours in the estimator graph, world
    estimate_age_s: Array  # (K,)
    near: Array  # (M, 8) x y z [m, ENU] keep-out radius [m] vx vy vz [m/s, ENU] above [m]
    near_age_s: float
    mode: int  # MODE_*
    start_age_s: float  # time since the first epoch, from which c(t) of the soft profile counts


class NeighbourMotion(NamedTuple):
    """Motion that a neighbour commanded in its newest message; two messages give the acceleration."""

    velocity: Vector3  # [m/s, ENU] at the end of the tick that the message was computed in
    time: float  # [s] stamp of the message, since the first epoch
    acceleration: Vector3  # [m/s^2, ENU]


class NeighbourMotions(NamedTuple):
    """Motions of those that one UAV hears."""

    parent: NeighbourMotion
    leader: NeighbourMotion


class StartErrors(NamedTuple):
    """Errors at the epoch; the plans of their decay begin with them."""

    task: Vector3  # sigma_d - sigma, the task's own units (leader: [m])
    attitude: Vector3  # [rad]
    slot: Vector3  # [m, ENU] from the UAV to its desired position relative to the leader
    edge: Vector3  # [m, ENU] from the UAV to its desired position relative to the parent


class Recovery(NamedTuple):
    """The time base of a UAV after an encounter, see behaviours/recovery.py."""

    disturbed: bool  # something kept the UAV from its plan in the last tick
    t: float  # [s] since the epoch when it was armed
    duration_s: float  # [s] 0: nothing to regain
    rest: Vector3  # A [m, ENU]
    moving: Vector3  # B [m, ENU]


class AgentState(NamedTuple):
    """The state that one UAV carries from tick to tick."""

    estimate: Estimate  # of the leader
    estimate_valid: bool  # the estimate has been initialised from a message
    velocity: Vector3  # filtered [m/s, ENU]
    rates: Vector3  # filtered [rad/s, FLU]
    adapted: AdaptationState
    obstacle_memory: Array  # (8, 7) x y z side active_s quiet_s used
    start: StartErrors
    recovery: Recovery
    standing_s: float  # time without a way to the place [s], see behaviours/recovery.py
    motions: NeighbourMotions
    hold: PoseTarget  # the pose at which holding began
    mode: int  # MODE_* of the previous tick; -1 before the first
    last_t: float  # t of the previous tick, to notice a new epoch [s]


class AgentDiagnostics(NamedTuple):
    """The causes of the behaviour of a UAV in one tick."""

    error: Vector3  # task error sigma_d - sigma (leader: position error [m])
    gain: float  # G(t) of the formation loop [1/s]
    singular_value: float  # smallest singular value of the scaled task Jacobian
    active_rows: int  # clearance rows that changed the velocity; 1 when it changed without one
    saturated: bool  # command filter or actuator limit reached
    holding: bool  # holding because of a stale neighbour or a hold leg
    priority_violation: float  # [m/s] change of a higher task's velocity by a lower one
    velocity_error: float  # [m/s] |V - V_r|, linear part
    deadlock: bool  # avoidance has long left no way to the place


class AgentOutputs(NamedTuple):
    """The messages of one UAV at this tick."""

    velocity: Vector3  # setpoint [m/s, ENU]
    yaw_rate: float  # setpoint [rad/s]
    force: Vector3  # [N], body FLU (quadrotor: (0, 0, thrust))
    torque: Vector3  # [N m], body FLU
    estimate: Estimate  # of the leader
    estimate_valid: bool  # it comes from a message: the neighbours may use it
    reported: Vector3  # [m/s, body FLU] velocity that the neighbours are told
    diagnostics: AgentDiagnostics


class ClearanceTask(NamedTuple):
    """The clearance task at one tick: the task with the highest priority."""

    velocity: Vector3  # J^+ of the binding constraints [m/s]; zero without any
    jacobian: Array  # (A, 3) their normals; without any its width means nothing
    secondary: Vector3  # velocity for the priority below: the formation's, with circulation added
    memory: Array  # obstacle memory after this tick


class Beside(NamedTuple):
    """The distance of a UAV from its plan by its own doing: without the part that it takes over from its parent."""

    deviation: Vector3  # [m, ENU] to the plan
    velocity: Vector3  # [m/s, ENU] of the plan: what the behaviour asks for without a deviation
    planned: bool  # an encounter is followed by a way back


class FormationPlace(NamedTuple):
    """The place of a UAV in the end."""

    error: Vector3  # [m, ENU] from the UAV to it
    velocity: Vector3  # [m/s, ENU] of it


class Behaviour(NamedTuple):
    """Velocity that one behaviour asks for, and the state of its task."""

    velocity: Vector3  # [m/s, ENU]
    error: Vector3  # sigma_d - sigma, the task's own units
    singular_value: float
    acceleration: Vector3  # [m/s^2, ENU] rate of `velocity` on the plan: the filter's lead
    slot_start: Vector3  # [m, ENU] start error that the plan of this epoch uses
    edge_start: Vector3  # [m, ENU] likewise, relative to the parent
    beside: Beside
    place: FormationPlace


class EpochErrors(NamedTuple):
    """Errors at the epoch, of which plans are made."""

    at_epoch: bool  # this tick is the epoch: the present errors count
    start: StartErrors
    recovery: Recovery  # after the last encounter
