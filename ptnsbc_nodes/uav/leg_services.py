"""The operator's services on the leader: /formation/{start,hold,land,stop} announce a leg."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

from ptnsbc_io.wire import HeaderTemplate, WireError, decode_header
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.legs import FIRST_LEG, Epochs
from ptnsbc_nodes.uav.slots import SlotDecider

LEAD_NS = 500_000_000
"""An epoch is announced this long before it begins, so that all UAVs switch at the same instant [ns]."""

_PERMIT_S = 5.0

_LEGS = {"start": FIRST_LEG, "hold": "hold", "land": "land", "stop": "land"}


def _decode_request(data: bytes) -> str:
    name = decode_header(data).frame_id
    if name not in _LEGS:
        raise WireError(f"request {name[:40]!r}: expected one of {', '.join(_LEGS)}")
    return name


class LegServices:
    """Answers the four services of the leader.

    In lock-step the first epoch is 0, where simulated time starts. Every other leg begins after
    `LEAD_NS`, but a stop in real time begins at once.
    """

    def __init__(
        self,
        node: Node,
        endpoints: Endpoints,
        edges: CommunicationGraph,
        epochs: Epochs,
        now_ns: Callable[[], int],
        waiting_for: Callable[[], Sequence[str]],
        decider: SlotDecider | None = None,
    ) -> None:
        """`now_ns`: time of the flight; `waiting_for`: empty when the leader is ready to start.

        `decider` decides the slots of each leg in formation, where they are open.
        """
        self._node = node
        self._endpoints = endpoints
        self._lockstep = edges.options.lockstep
        self._epochs = epochs
        self._now_ns = now_ns
        self._waiting_for = waiting_for
        self._decider = decider
        self._listeners = edges.epoch_listeners()
        self._publish = endpoints.publisher(topics.EPOCH, edges.epoch_readers())
        self._signed = edges.options.seal is not None
        self._requested_s: dict[
            str, float
        ] = {}  # when each service was last announced on /formation/request
        endpoints.listen(topics.REQUEST, _decode_request, self._on_announced, required=False)
        self._services = [
            node.create_service(
                Trigger, f"{endpoints.fleet}/formation/{name}", self._on_request(name)
            )
            for name in _LEGS
        ]

    def missing_listeners(self) -> list[str]:
        """UAVs that do not listen to the epoch yet."""
        return self._endpoints.unmatched(topics.EPOCH, self._listeners)

    def close(self) -> None:
        """Remove the services from the node."""
        for service in self._services:
            self._node.destroy_service(service)

    def _on_request(self, name: str) -> Callable[[Any, Any], Any]:
        def on_request(_request: Any, response: Any) -> Any:
            refusal = self._refusal(name)
            response.success = refusal is None
            response.message = refusal or self._announce(name)
            return response

        return on_request

    def _on_announced(self, name: str) -> None:
        self._requested_s[name] = time.monotonic()

    def _is_permitted(self, name: str) -> bool:
        """A service carries no seal: the sealed message before its call does. It permits one call."""
        announced_s = self._requested_s.pop(name, float("-inf"))
        return not self._signed or time.monotonic() - announced_s < _PERMIT_S

    def _refusal(self, name: str) -> str | None:
        if not self._is_permitted(name):
            return f"security: signed: expected a sealed {topics.REQUEST.name} before the call"
        if not self._epochs.announced and name != "start":
            return "not started: call /formation/start first"
        missing = self._waiting_for() if name == "start" else ()
        return f"the leader waits for {' '.join(missing)}" if missing else None

    def _announce(self, name: str) -> str:
        t0_ns, leg = self._epoch_ns(name), _LEGS[name]
        if leg == FIRST_LEG and self._decider is not None:
            self._decider.decide(t0_ns)
        self._epochs.announce(t0_ns, leg)
        self._publish(HeaderTemplate(leg).encode(t0_ns))
        return f"leg {leg} from {t0_ns * 1e-9:.3f} s"

    def _epoch_ns(self, name: str) -> int:
        if self._lockstep and not self._epochs.announced:
            return 0
        at_once = name == "stop" and not self._lockstep
        return self._now_ns() + (0 if at_once else LEAD_NS)
