"""Drives the life cycle of a fleet's nodes: configures and activates each node as soon as it is there."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node

_CONFIGURE, _ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
_STEPS = (_CONFIGURE, _ACTIVATE)
_ANSWER_S = 5.0


class _ManagedTransitions:
    """One node on its way to active.

    A request may arrive without its answer: over a network that loses packets a discovery server may never introduce
    the client to the node. A transition without an answer may have happened, so the other one is tried next.
    """

    def __init__(self, node: Node, name: str, doubtful: bool, held: Callable[[], bool]) -> None:
        self._node, self._name, self._held = node, name, held
        self._client = self._new_client()
        self._steps = list(_STEPS)
        self._asked_s = float("-inf")
        self._call: Any = None
        self._doubtful = doubtful  # an answer may have been lost: a refusal then has no meaning
        self.refused = False

    @property
    def asked(self) -> bool:
        return self._asked_s > float("-inf")

    @property
    def done(self) -> bool:
        return not self._steps or self.refused

    @property
    def _may_ask(self) -> bool:
        return bool(self._steps) and not (self._steps[0] == _ACTIVATE and self._held())

    def look(self) -> None:
        """Request the next transition when no answer is awaited."""
        silent = time.monotonic() - self._asked_s > _ANSWER_S
        if not self.done and silent and self._may_ask and self._client.service_is_ready():
            if self._call is not None:
                self._doubtful = True
                self._turn()
                # The network may have introduced one direction only: a new client is introduced anew.
                self.close()
                self._client, self._call = self._new_client(), None
                return
            self._ask()

    def arrived(self) -> None:
        self._steps.clear()

    def close(self) -> None:
        self._node.destroy_client(self._client)

    def _new_client(self) -> Any:
        return self._node.create_client(ChangeState, f"{self._name}/change_state")

    def _ask(self) -> None:
        request = ChangeState.Request()
        request.transition.id = self._steps[0]
        self._asked_s = time.monotonic()
        self._call = self._client.call_async(request)
        self._call.add_done_callback(self._on_answer)

    def _on_answer(self, call: Any) -> None:
        if call is not self._call or self.done:
            return
        self._call = None
        made = bool(call.result().success)
        self.refused = not (made or self._doubtful)
        if self.refused:
            return
        if made and self._steps[0] == _ACTIVATE:
            self._steps.clear()
        elif self._steps == [_ACTIVATE, _CONFIGURE]:  # not configured yet, or active already
            self._turn()
        else:
            self._steps.pop(0)
        if self._may_ask:
            self._ask()

    def _turn(self) -> None:
        if not self._held():  # whether or not it is configured, it is not asked to become active
            self._steps.append(self._steps.pop(0))


class LifecycleManager:
    """Takes any number of nodes to active; call `look` regularly."""

    def __init__(self, node: Node, held: Collection[str] = ()) -> None:
        """`held`: names of processes whose nodes stay inactive for as long as they are in there."""
        self._node, self._held = node, held
        self._nodes: dict[str, _ManagedTransitions] = {}
        self.refused: list[str] = []
        """Names of those that refused a transition."""

    def manage(self, name: str, node: str, *, doubtful: bool = False) -> None:
        """Take the node with this full name to active, from the beginning.

        Args:
            name: Of the process, for `refused`.
            node: Full name.
            doubtful: It may be on its way already, so that a refusal has no meaning.
        """
        if name in self._nodes:
            self._nodes[name].close()
        self._nodes[name] = _ManagedTransitions(
            self._node, node, doubtful, lambda: name in self._held
        )

    def asked(self, name: str) -> bool:
        """True if a transition has been requested of the process."""
        return name not in self._nodes or self._nodes[name].asked

    def look(self) -> None:
        """Continue with all nodes that are not active yet."""
        for name, one in list(self._nodes.items()):
            one.look()
            if one.done:
                if one.refused:
                    self.refused.append(name)
                one.close()
                del self._nodes[name]

    def arrived(self, name: str) -> None:
        """The diagnostics of the process say that its node is active: it gets no further request."""
        if name in self._nodes:
            self._nodes[name].arrived()
