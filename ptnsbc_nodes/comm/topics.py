"""The topics of a formation: names, message types, and how each is delivered.

The table in `docs/architecture.md` is made of this. Importing this needs no ROS; `message_class` does.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple


class Role(Enum):
    """The delivery of a topic; `qos.profile` turns it into a profile."""

    STATE = "state"  # the next message replaces this one
    EVENT = "event"  # each message matters
    LATCHED = "latched"  # the last message matters, also to nodes that join later


CONTROL_RATE, SENSOR_RATE, STATUS_RATE, ON_DEMAND = "control", "sensor", "5 Hz", "on demand"


class Topic(NamedTuple):
    """Name, type and delivery of a topic, and how often there is a message on it, for readers."""

    name: str
    type: str  # package/msg/Name
    role: Role
    rate: str = CONTROL_RATE


EPOCH = Topic("/formation/epoch", "std_msgs/msg/Header", Role.LATCHED, "once a leg")
"""A leg begins: stamp t0, frame_id its name."""
SLOTS = Topic("/formation/slots", "std_msgs/msg/Header", Role.LATCHED, "once a leg")
"""With `formation.assignment: optimal`: stamp t0 of a leg, frame_id the slot of every UAV, "1:1 2:5 3:2"."""
SETPOINT = Topic("/formation/setpoint", "nav_msgs/msg/Odometry", Role.STATE, ON_DEMAND)
"""With a leader of kind `stream`: where it is to be, from a program of the user; all in the world frame."""
TAKEN = Topic("/formation/setpoint_taken", "nav_msgs/msg/Odometry", Role.EVENT, ON_DEMAND)
"""A setpoint that the leader follows: stamp from when."""
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", Role.EVENT, STATUS_RATE)
"""State and counters of every node."""
MARKERS = Topic("/formation/markers", "visualization_msgs/msg/MarkerArray", Role.EVENT, STATUS_RATE)
"""The flight drawn, for viewers; with real vehicles in bags only."""
ORIGIN = Topic("/formation/origin", "sensor_msgs/msg/NavSatFix", Role.LATCHED, "once")
"""The place of the leader's local origin on the Earth; from its bridge to the others."""
EMERGENCY = Topic("/formation/emergency", "std_msgs/msg/Header", Role.EVENT, ON_DEMAND)
"""frame_id `land` or `kill` from an operator, or `apart` from a bridge, to all bridges: needs no leader."""
CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", Role.STATE)
"""Time of the simulated world."""
TF = Topic("/tf", "tf2_msgs/msg/TFMessage", Role.EVENT, "20 Hz")
"""Frames of the bodies, from sim and bridges where tf2_msgs is installed; the recorder makes it of the odometry."""

LOST = Topic("/formation/lost", "std_msgs/msg/Header", Role.LATCHED, "once a loss")
"""Names of processes (uavN, recorder) that have ended, from the launcher: no process waits for them."""
OVER = Topic("/formation/over", "std_msgs/msg/Header", Role.LATCHED, "once a flight")
"""The flight is over: from the launcher that leads to those on other computers."""
READY = Topic("/formation/ready", "diagnostic_msgs/msg/DiagnosticArray", Role.EVENT, STATUS_RATE)
"""/diagnostics of lock-step nodes before simulated time begins. It has a topic of its own because how long that
takes is chance, and /diagnostics is in the bag."""
RECORDED = Topic("/formation/recorded", "std_msgs/msg/Header", Role.EVENT)
"""Stamp up to which the recorder has taken in every topic of a lock-step flight; the sim never runs far ahead."""
RECORDED_EVERY = 10
"""Ticks from one word of a recorder in lock-step to the next."""

REQUEST = Topic("/formation/request", "std_msgs/msg/Header", Role.EVENT, ON_DEMAND)
"""frame_id the leg that an operator calls the leader's service for next; with `security: signed` the leader answers
no call without it."""

SEVERAL_PUBLISHERS = frozenset(
    one.name for one in (DIAGNOSTICS, READY, LOST, EMERGENCY, TF, REQUEST)
)
"""Topics on which several nodes publish."""

RECORDER, SIM, LAUNCHER = "recorder", "sim", "fleet"
"""Names of recorder, sim and the launcher that leads among the processes of a flight."""


def odom(uav: int) -> Topic:
    """Own state of a UAV: pose in the world (ENU), velocities in the body (FLU)."""
    return _state(uav, "odom", "nav_msgs/msg/Odometry")


def truth(uav: int) -> Topic:
    """True state of a UAV, when positions are noisy, gusts blow or messages get lost, and of a vehicle whose autopilot
    simulates it: the verdict is judged by it.
    """
    return _state(uav, "truth", "nav_msgs/msg/Odometry")


def near(uav: int) -> Topic:
    """Near objects: x y z (exact_x to exact_z) radius vx vy vz, and above where a keep-out is higher than wide."""
    return _state(uav, "near", "sensor_msgs/msg/PointCloud2")._replace(rate=SENSOR_RATE)


def formation_state(uav: int) -> Topic:
    """Pose and commanded velocity of a UAV for its children, and of the leader for UAVs with a leader link."""
    return _state(uav, "formation_state", "nav_msgs/msg/Odometry")


def leader_estimate(uav: int) -> Topic:
    """A UAV's estimate of the leader, for its neighbours in the estimator graph; velocities in the world."""
    return _state(uav, "leader_estimate", "nav_msgs/msg/Odometry")


def velocity_setpoint(uav: int) -> Topic:
    """Commanded velocity, ENU."""
    return _state(uav, "setpoint/velocity", "geometry_msgs/msg/TwistStamped")


def wrench_setpoint(uav: int) -> Topic:
    """Commanded force and torque, body FLU."""
    return _state(uav, "setpoint/wrench", "geometry_msgs/msg/WrenchStamped")


def tick(uav: int) -> Topic:
    """Real time only: which messages a step used, and when (`step_log`)."""
    return Topic(f"/uav{uav}/tick", "std_msgs/msg/Int64MultiArray", Role.EVENT)


def snapshot(uav: int) -> Topic:
    """Real time only: the state of the controller, once a second (`step_log`)."""
    return Topic(f"/uav{uav}/snapshot", "std_msgs/msg/Float64MultiArray", Role.EVENT, "1 Hz")


def track(uav: int) -> Topic:
    """Like `odom`, of a vehicle that has left the formation: other vehicles still keep clear of it."""
    return _state(uav, "track", "nav_msgs/msg/Odometry")


def limits(uav: int) -> Topic:
    """Speed [m/s] and acceleration [m/s²] of a real vehicle, from its bridge to its planner."""
    return Topic(f"/uav{uav}/limits", "std_msgs/msg/Float64MultiArray", Role.LATCHED, "once")


def battery(uav: int) -> Topic:
    """Battery of a real vehicle, from its bridge."""
    return _state(uav, "battery", "sensor_msgs/msg/BatteryState")._replace(rate=STATUS_RATE)


def robot_description(uav: int) -> Topic:
    """URDF of a UAV for viewers: one link, `base_link`, without meshes."""
    return Topic(f"/uav{uav}/robot_description", "std_msgs/msg/String", Role.LATCHED, "once")


def of_uav(uav: int) -> tuple[Topic, ...]:
    """Every topic of one UAV."""
    between = formation_state(uav), leader_estimate(uav)
    return (odom(uav), near(uav), *between, velocity_setpoint(uav), wrench_setpoint(uav))


def notes(uav: int) -> tuple[Topic, ...]:
    """The log of a UAV in real time, from which its steps can be re-run; lock-step steps follow from its rule."""
    return (tick(uav), snapshot(uav))


def recorded(
    uavs: Iterable[int],
    *,
    lockstep: bool = True,
    with_truth: bool = False,
    with_slots: bool = False,
    with_stream: bool = False,
) -> tuple[Topic, ...]:
    """The topics that a recorder of these UAVs subscribes to; it makes /tf itself, out of odometry."""
    listed: list[Topic] = []
    for uav in uavs:
        listed += [*of_uav(uav), *(() if lockstep else notes(uav))]
        listed += [truth(uav)] if with_truth else []
    decided = (*((SLOTS,) if with_slots else ()), *((TAKEN,) if with_stream else ()))
    return (*listed, EPOCH, *decided, DIAGNOSTICS, MARKERS, CLOCK)


def in_bag(uavs: Iterable[int], **kinds: bool) -> tuple[Topic, ...]:
    """Every topic of a bag of these UAVs; `kinds` as of `recorded`."""
    return (*recorded(uavs, **kinds), TF)


def tf_is_available() -> bool:
    """True if /tf can be published: tf2_msgs comes with ROS from apt, or by `make setup-messages` beside the wheels."""
    return find_spec("tf2_msgs") is not None


def message_class(topic: Topic) -> type[Any]:
    """The rclpy class of the topic's messages."""
    package, _, name = topic.type.split("/")
    kind: type[Any] = getattr(import_module(f"{package}.msg"), name)
    return kind


def _state(uav: int, name: str, kind: str) -> Topic:
    return Topic(f"/uav{uav}/{name}", kind, Role.STATE)
