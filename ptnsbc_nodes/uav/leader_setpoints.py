"""The setpoints of a user's program, on their way to the leader of a formation."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from ptnsbc_core.types import Array
from ptnsbc_io.wire import OdometryDecoder, OdometryTemplate, Stamped
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.agent_messages import WORLD_FRAME
from ptnsbc_nodes.comm.door import RealTimeStamps, in_order
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.legs import Epochs
from ptnsbc_sim.scenario import Scenario


class _Taken(NamedTuple):
    """A setpoint that the leader can follow."""

    stamp_ns: int  # from when
    odometry: Array  # (13,)
    scenario: Scenario  # with it


class LeaderSetpoints:
    """Hears setpoints, and has the leader follow those that it can follow.

    A setpoint counts from the tick after its arrival. In which tick that is decides the program that sends it; the
    leader tells it on /formation/setpoint_taken, by which the bag is judged and run again.
    """

    def __init__(
        self, endpoints: Endpoints, readers: int, epochs: Epochs, next_ns: Callable[[], int]
    ) -> None:
        """`next_ns`: time of the flight from which on a setpoint can count; `readers`: of those that are taken."""
        self._epochs = epochs
        self._next_ns = next_ns
        self._template = OdometryTemplate(WORLD_FRAME, WORLD_FRAME)
        self._tell = endpoints.publisher(topics.TAKEN, readers)
        stamps = RealTimeStamps(next_ns)
        self._decode = in_order(OdometryDecoder(WORLD_FRAME, WORLD_FRAME), stamps)
        endpoints.listen(topics.SETPOINT, self._planned, self._take, required=False)

    def _planned(self, data: bytes) -> _Taken:
        message: Stamped = self._decode(data)
        now_ns = self._next_ns()
        return _Taken(now_ns, message.values, self._epochs.following(now_ns, message.values))

    def _take(self, taken: _Taken) -> None:
        self._epochs.scenario = taken.scenario
        self._tell(self._template.encode(taken.stamp_ns, taken.odometry))
