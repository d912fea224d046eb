"""Subscriptions of a node that hear the first publisher of a topic."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ptnsbc_nodes.comm.door import Refusals
from ptnsbc_nodes.comm.senders.first import FirstSender, Yields
from ptnsbc_nodes.comm.senders.taking import Taken, tell_gids
from ptnsbc_nodes.comm.topics import ON_DEMAND, Role, Topic

_UNNAMED = "_NODE_NAME_UNKNOWN_"  # of rmw_dds_common


def first_sender(node: Node, name: str, topic: Topic, *, lockstep: bool) -> FirstSender:
    """The rule of a topic; `name`: after remapping."""
    state = topic.role is Role.STATE
    yields = Yields.SILENT if state else Yields.AT_ONCE
    return FirstSender(
        Yields.UNNAMED if lockstep else yields,
        partial(_publishers, node, name),
        any_node=topic.rate == ON_DEMAND,  # from programs of the user, too
        by_numbers=state,
    )


def hear_first(
    subscription: Subscription,
    first: FirstSender,
    refusals: Refusals,
    several: Callable[[], bool] = lambda: False,
) -> None:
    """Refuse what others than the first publisher send; `several`: all publishers are heard."""
    name, door = subscription.topic, subscription.callback

    def take(taken: Taken) -> None:
        if several():
            heard.by_gid = False
        elif heard.by_gid or not first.follows(taken.number):
            heard.by_gid = True
            if objection := first.objection(taken.gid, taken.number):
                refusals.add(name, objection)
                return
            heard.by_gid = not first.is_alone()
        door(taken.data)

    heard = tell_gids(subscription, take)


def _publishers(node: Node, name: str) -> dict[bytes, str]:
    found = node.get_publishers_info_by_topic(name)
    return {bytes(info.endpoint_gid): _name_of(info) for info in found}


def _name_of(info: TopicEndpointInfo) -> str:
    """The full name of a node; empty as long as its participant has not told it."""
    if info.node_name == _UNNAMED:
        return ""
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"
