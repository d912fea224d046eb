"""Whose turn it is in lock-step: which UAV may be told its next state. No ROS in here.

A barrier at every tick would leave the machine idle while the last UAV thinks. It is needed only where the
world looks at all vehicles at once (near objects, status, markers): a *meeting*. Between meetings a
vehicle moves on as soon as its own setpoint is in, so that nobody waits for who does not concern it; the
UAVs themselves wait for their neighbours' messages. The result is the same, bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ptnsbc_nodes.comm.graph import LEAD_TICKS


class LockstepScheduler:
    """Ticks of all vehicles.

    Args:
        uav_ids: all vehicles.
        end: the tick at which the flight is over, told to nobody.
        meetings: periods [ticks] at whose multiples all must be there.
    """

    def __init__(self, uav_ids: Iterable[int], end: int, meetings: Sequence[int]) -> None:
        self._at = dict.fromkeys(uav_ids, 0)
        self._untold = list(self._at)
        self._slowest = 0
        self._end = end
        self._meetings = tuple(meetings)

    @property
    def slowest(self) -> int:
        """The tick that every vehicle has reached."""
        return self._slowest

    def at(self, uav_id: int) -> int:
        """The tick of one vehicle's state."""
        return self._at[uav_id]

    def awaited(self, uav_id: int) -> bool:
        """Whether the UAV has been told its state and has not answered yet."""
        return uav_id not in self._untold

    def tell(self, uav_id: int) -> None:
        """The UAV has been told its state."""
        self._untold.remove(uav_id)

    def step(self, uav_id: int) -> None:
        """The vehicle has moved on by one tick."""
        tick = self._at[uav_id]
        self._at[uav_id] = tick + 1
        self._untold.append(uav_id)
        if tick == self._slowest:
            self._slowest = min(self._at.values())

    def due(self) -> list[int]:
        """Who may be told its state now, in the order in which they came."""
        return [i for i in self._untold if self._may_go(self._at[i])]

    def _may_go(self, tick: int) -> bool:
        for period in self._meetings:
            if tick % period == 0:
                return tick == self._slowest  # nobody passes a meeting before the last has come
        return tick < self._end and tick <= self._slowest + LEAD_TICKS
