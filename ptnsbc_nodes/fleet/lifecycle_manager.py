"""Drives the life cycle of a fleet's nodes: configures and activates each node as soon as it is there."""

from __future__ import annotations

import time
from collections.abc import Callable
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

    def _may_ask(self) -> bool:
        return bool(self._steps) and not (self._steps[0] == _ACTIVATE and self._held())

    def look(self) -> None:
        """Request the next transition when no answer is awaited."""
        silent = time.monotonic() - self._asked_s > _ANSWER_S
        if not self.done and silent and self._may_ask() and self._client.service_is_ready():
            if self._call is not None:
                self._doubtful = True
                self._turn()
                # The network may have introduced one direction only: a new client is introduced anew.
                self.close()
                self._client, self._call = self._new_client(), None
                return
            self._ask()

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
        if self._may_ask():
            self._ask()

    def _turn(self) -> None:
        if not self._held():  # whether or not it is configured, it is not asked to become active
            self._steps.append(self._steps.pop(0))


class LifecycleManager:
    """Takes any number of nodes to active; call `look` regularly."""

    def __init__(self, active: set[str]) -> None:
        """`active`: processes whose diagnostics say that they are active: they get no further request."""
        self.held: set[str] = set()  # processes whose nodes stay inactive while they are in there
        self.refused: list[str] = []  # those that refused a transition
        self._active = active
        self._managed: dict[str, str] = {}  # node by process
        self._nodes: dict[str, _ManagedTransitions] = {}

    def join(self, node: Node, fleet: str) -> None:
        """Ask from this node, in a fleet with this namespace; those that are managed may be on their way already."""
        self._node, self._fleet = node, fleet
        self._nodes.clear()
        for name in self._managed:
            self._begin(name, doubtful=True)

    def manage(self, name: str, node: str) -> None:
        """Take a node to active, from the beginning and as soon as it is there.

        `name` is that of its process, as on /diagnostics; `node` is below the fleet, `/uav3/controller`.
        """
        self._managed[name] = node
        self._active.discard(name)
        self._begin(name, doubtful=False)

    def _begin(self, name: str, *, doubtful: bool) -> None:
        if name in self._nodes:
            self._nodes[name].close()
        self._nodes[name] = _ManagedTransitions(
            self._node, self._fleet + self._managed[name], doubtful, lambda: name in self.held
        )

    def asked(self, name: str) -> bool:
        """True if a transition has been requested of the process."""
        return name not in self._nodes or self._nodes[name].asked

    def look(self) -> None:
        """Continue with all nodes that are not active yet."""
        for name, transitions in list(self._nodes.items()):
            if name not in self._active:
                transitions.look()
                if not transitions.done:
                    continue
            if transitions.refused:
                self.refused.append(name)
            transitions.close()
            del self._nodes[name]
