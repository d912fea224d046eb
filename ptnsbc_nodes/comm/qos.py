"""Quality of service of our topics.

State and setpoints are best effort in real time: at 20 % loss and 50 ms delay the 99th percentile
of the latency is 55 ms, and 2.2 s if delivery is reliable, because a repeated message is already old.
In lock-step every message counts and time does not.
"""

from __future__ import annotations

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

from ptnsbc_nodes.comm.topics import STATUS_RATE, Role, Topic


def keep_last(depth: int, *, reliable: bool, latched: bool = False) -> QoSProfile:
    """A profile that keeps the last `depth` messages."""
    reliability = QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT
    durability = QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=reliability,
        durability=durability,
    )


STATE_REALTIME = keep_last(1, reliable=False)
STATE_LOCKSTEP = keep_last(10, reliable=True)
EVENT = keep_last(10, reliable=True)
LATCHED = keep_last(1, reliable=True, latched=True)
# The last message alone is not enough: a node that joins late must learn the first epoch, and of every lost UAV.
_ENDS_LATCHED = keep_last(64, reliable=True, latched=True)
# With a queue of one the messages of an outsider would push out the true one before it is taken.
_REQUESTED_STATE = keep_last(32, reliable=False)
# The lock-step rule keeps all nodes within a few ticks, but not the recorder: messages that its socket drops in a burst
# must still be there when it asks for them again. A history fills up slowly with what is published 5 times a second:
# the sim is at most 80 of them ahead of the recorder, and those of RViz are large.
_LOCKSTEP_HISTORY = keep_last(1000, reliable=True)
_LOCKSTEP_STATUSES = keep_last(100, reliable=True)

RECORDER_REALTIME = keep_last(100, reliable=False)
RECORDER_RELIABLE = keep_last(1000, reliable=True)
RECORDER_LATCHED = keep_last(100, reliable=True, latched=True)

NO_READER_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
NO_WRITER_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
"""No callbacks for lost messages or incompatible profiles: a process that takes such an event while the next one
arrives can wait for ever, in rmw_fastrtps before pull request 890 of 2026 (docs/platform.md)."""


def profile(topic: Topic, *, lockstep: bool) -> QoSProfile:
    """The profile of `topic` as a bag tells it."""
    if topic.role is Role.STATE:
        return STATE_LOCKSTEP if lockstep else STATE_REALTIME
    return LATCHED if topic.role is Role.LATCHED else EVENT


def offered(topic: Topic, *, lockstep: bool) -> QoSProfile:
    """The profile that a publisher of the fleet offers."""
    if topic.role is Role.LATCHED:
        return _ENDS_LATCHED
    if lockstep:
        return _LOCKSTEP_STATUSES if topic.rate == STATUS_RATE else _LOCKSTEP_HISTORY
    return profile(topic, lockstep=False)


def requested(topic: Topic, *, lockstep: bool) -> QoSProfile:
    """The profile that a subscription of the fleet requests."""
    if topic.role is Role.LATCHED:
        return _ENDS_LATCHED
    if topic.role is Role.STATE and not lockstep:
        return _REQUESTED_STATE
    return profile(topic, lockstep=lockstep)


def recorder_profile(topic: Topic, *, lockstep: bool) -> QoSProfile:
    """The profile with which the recorder requests `topic`: fits every publisher of ours.

    Topics at the control rate are best effort in real time, as they are offered; the deep queue covers pauses
    of the recorder. The other topics are rare and reliable: during the discovery of twenty UAVs best effort
    lost a status now and then.
    """
    if topic.role is Role.LATCHED:
        return RECORDER_LATCHED
    if lockstep or topic.role is Role.EVENT:
        return RECORDER_RELIABLE
    return RECORDER_REALTIME
