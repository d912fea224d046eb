"""The operator's services on the leader: /formation/{start,hold,land,stop} announce a leg."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from rclpy.node import Node
from std_srvs.srv import Trigger

from ptnsbc_io.wire import HeaderTemplate
from ptnsbc_nodes.comm.legs import FIRST_LEG, Epochs

LEAD_NS = 500_000_000
"""Announced this long before the epoch, so that all UAVs switch at the same instant [ns]."""

_LEGS = {"start": FIRST_LEG, "hold": "hold", "land": "land", "stop": "land"}


class LegServiceCallbacks(NamedTuple):
    """What the services need of their node."""

    publish: Callable[[bytes], None]  # /formation/epoch
    now_ns: Callable[[], int]  # time of the flight [ns]
    epochs: Epochs  # the legs announced so far
    waiting_for: Callable[[], Sequence[str]]  # empty when the leader is ready


class LegServices:
    """Answers the four services of the leader.

    In lock-step the first epoch is 0, where simulated time starts; any other leg begins after
    `LEAD_NS`, but a stop in real time begins at once.
    """

    def __init__(
        self, node: Node, fleet: str, instruments: LegServiceCallbacks, lockstep: bool
    ) -> None:
        self._node = node
        self._tools = instruments
        self._lockstep = lockstep
        self._services = [
            node.create_service(Trigger, f"{fleet}/formation/{name}", self._answer(name))
            for name in _LEGS
        ]

    def close(self) -> None:
        """Take the services away."""
        for service in self._services:
            self._node.destroy_service(service)

    def _answer(self, name: str) -> Callable[[Any, Any], Any]:
        def answer(_request: Any, response: Any) -> Any:
            refusal = self._refusal(name)
            response.success = refusal is None
            response.message = refusal or self._announce(name)
            return response

        return answer

    def _refusal(self, name: str) -> str | None:
        if not self._tools.epochs.announced and name != "start":
            return "not started: call /formation/start first"
        missing = self._tools.waiting_for() if name == "start" else ()
        return f"the leader waits for {' '.join(missing)}" if missing else None

    def _announce(self, name: str) -> str:
        t0_ns = self._epoch_ns(name)
        leg = _LEGS[name]
        self._tools.epochs.announce(t0_ns, leg)
        self._tools.publish(HeaderTemplate(leg).encode(t0_ns))
        return f"leg {leg} from {t0_ns * 1e-9:.3f} s"

    def _epoch_ns(self, name: str) -> int:
        if self._lockstep and not self._tools.epochs.announced:
            return 0
        urgent = name == "stop" and not self._lockstep
        return self._tools.now_ns() + (0 if urgent else LEAD_NS)
