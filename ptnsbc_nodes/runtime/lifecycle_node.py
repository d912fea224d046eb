"""A node with a life cycle: the manager of the fleet configures, activates, deactivates and cleans it up.

Its `ConfiguredNode` does the work of each transition. A user's error refuses the transition and is logged; any
other error ends the process.

This is the one module that reaches into rclpy (7.1), for two promises. No request ends a process in flight: rclpy lets
the RCLError of a transition that is not possible now out of its callback (`_refuse_impossible_requests`). A node that
has ended is out of the graph: rclpy forgets its transition topic (`destroy_node`).
"""

from __future__ import annotations

import gc
import traceback
from collections.abc import Callable
from typing import Any, Protocol

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.comm.endpoints import Endpoints


class ConfiguredNode(Protocol):
    """The behaviour of a configured node: it has topics from the start, and acts while it is active."""

    endpoints: Endpoints

    def activate(self) -> None:
        """Begin."""

    def deactivate(self) -> None:
        """Stop, so that `activate` can begin again; a PtnsbcError refuses."""

    def close(self) -> None:
        """Remove all topics, timers and services from the node."""


class ManagedNode(LifecycleNode):
    """A lifecycle node whose work `assign` defines."""

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.work: ConfiguredNode | None = None
        self.refusal: PtnsbcError | None = None  # of the newest transition
        self._by_itself = False  # `autostart` raises a refusal instead of logging it
        self.broken = False  # an error that is not the user's has come up
        self._make: Callable[[], ConfiguredNode | None] = lambda: None
        self._end: Callable[[], None] = lambda: None
        _refuse_impossible_requests(self)

    def assign(self, make: Callable[[], ConfiguredNode], on_end: Callable[[], None]) -> None:
        """Define the node before it is served: `make` configures, `on_end` ends the process."""
        self._make, self._end = make, on_end

    @property
    def state(self) -> str:
        """unconfigured, inactive, active or finalized."""
        return str(self._state_machine.current_state[1])

    def autostart(self) -> None:
        """Configure and activate without being asked; raises the error that refuses it."""
        self._by_itself = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() is not TransitionCallbackReturn.SUCCESS and self.refusal is not None:
                raise self.refusal
        self._by_itself = False

    def finish(self) -> None:
        """Close the node and publish its last transition; the process ends next."""
        self._end = lambda: None
        self._close()
        if self.state != "finalized":
            self.trigger_shutdown()

    def destroy_node(self) -> None:
        """Destroy also the transition topic, which rclpy forgets: the node would stay in the graph."""
        self._state_machine.destroy_when_not_in_use()
        super().destroy_node()

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Make the topics, timers and services."""
        return self._transition(lambda: setattr(self, "work", self._make()))

    def on_activate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to act."""
        gc.freeze()  # what was made so far lives as long as the node works: no collection need look at it
        return self._transition(self.work.activate if self.work is not None else lambda: None)

    def on_deactivate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Stop acting."""
        return self._transition(self.work.deactivate if self.work is not None else lambda: None)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Remove them again."""
        return self._transition(self._close)

    def on_shutdown(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """End the process."""
        self._end()
        return TransitionCallbackReturn.SUCCESS

    def _close(self) -> None:
        if self.work is not None:
            self.work.close()
            self.work = None

    def _transition(self, work: Callable[[], object]) -> TransitionCallbackReturn:
        self.refusal = None
        try:
            work()
        except PtnsbcError as error:
            self.refusal = error
            if not self._by_itself:
                self.get_logger().error(" ".join(str(error).split()))
            return TransitionCallbackReturn.FAILURE
        except Exception:  # rclpy would ignore it
            self.broken = True
            self.get_logger().fatal(traceback.format_exc())
            self._end()
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS


def _refuse_impossible_requests(node: ManagedNode) -> None:
    """Refuse a transition that is not possible now: a launcher whose answer was late asks again."""
    machine, service = node._state_machine, node._service_change_state
    change = service.callback

    def guarded(request: Any, response: Any) -> Any:
        possible = {one[0]: one[1] for one in machine.available_transitions}
        wanted = request.transition
        if wanted.label in possible.values() or (not wanted.label and wanted.id in possible):
            return change(request, response)
        node.get_logger().warning(
            f"transition {wanted.label or wanted.id}: not possible now, {node.state}: expected "
            f"one of {', '.join(possible.values())}"
        )
        response.success = False
        return response

    service.callback = guarded
