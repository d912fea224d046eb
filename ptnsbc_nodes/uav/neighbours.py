"""The subscriptions of a UAV to the states and estimates of its neighbours."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from rclpy.node import Node

from ptnsbc_io.wire import OdometryDecoder, Stamped
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME, body_frame
from ptnsbc_nodes.comm.door import LockstepStamps, RefusedMessage, in_lockstep, in_order
from ptnsbc_nodes.comm.endpoints import Endpoints, full_name
from ptnsbc_nodes.comm.topics import Topic
from ptnsbc_nodes.uav.inbox import Inbox
from ptnsbc_nodes.uav.timing import UavTiming


class NeighbourListener:
    """Puts what neighbours send into the inbox, and then calls `advance`."""

    def __init__(
        self, node: Node, endpoints: Endpoints, timing: UavTiming, advance: Callable[[], None]
    ) -> None:
        self._node = node
        self._endpoints = endpoints
        self._timing = timing
        self._advance = advance

    def listen(self, inbox: Inbox) -> None:
        """Subscribe to every sender of an inbox."""
        for sender, handler in inbox.state_handlers().items():
            frames = OdometryDecoder(WORLD_FRAME, body_frame(sender, self._endpoints.fleet))
            miss = partial(inbox.miss, sender, estimate=False)
            self._listen_to(topics.formation_state(sender), frames, handler, miss)
        for sender, handler in inbox.estimate_handlers().items():
            frames = OdometryDecoder(WORLD_FRAME, WORLD_FRAME)
            miss = partial(inbox.miss, sender, estimate=True)
            self._listen_to(topics.leader_estimate(sender), frames, handler, miss)

    def _listen_to(
        self,
        topic: Topic,
        decode: Callable[[bytes], Stamped],
        handler: Callable[[Stamped], None],
        miss: Callable[[int], None],
    ) -> None:
        advance, refusals = self._advance, self._endpoints.refusals

        def on_message(message: Stamped) -> None:
            handler(message)
            advance()

        rule = self._timing.stamp_rule()
        if not isinstance(rule, LockstepStamps):
            self._endpoints.listen(topic, in_order(decode, rule), on_message)
            return
        name = full_name(self._node, topic)

        def on_any(message: Stamped | RefusedMessage) -> None:
            if isinstance(message, Stamped):
                handler(message)
            else:  # a lock-step flight does not wait for what cannot be used
                refusals.add(name, message.reason)
                miss(message.stamp_ns)
            advance()

        self._endpoints.listen(topic, in_lockstep(decode, rule), on_any)
