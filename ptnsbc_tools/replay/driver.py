"""What both ways of a re-run have in common: steps wait until all that belongs to them has streamed by."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from typing import Generic, NamedTuple, TypeVar

from ptnsbc_io.wire import WireError
from ptnsbc_tools.replay.difference import Difference, Mismatch
from ptnsbc_tools.replay.replay_state import ReplayState
from ptnsbc_tools.replay.uav_replay import UavReplay

WINDOW_NS = 1_000_000_000
"""How much later than a step its inputs and outputs may have been recorded."""

S = TypeVar("S")


class StepIndex(NamedTuple):
    """A step as the flight counts it."""

    tick: int
    stamp_ns: int


class Driver(ABC, Generic[S]):
    """Makes the steps of all UAVs in the order in which they were recorded."""

    triggers: Mapping[str, int]  # topic whose messages stand for steps, and the UAV

    def __init__(self, desk: ReplayState) -> None:
        self.desk = desk
        self._due: deque[tuple[int, int, S]] = deque()  # log time, UAV, step

    @abstractmethod
    def read(self, uav: int, data: bytes) -> S:
        """The step that a trigger stands for."""

    @abstractmethod
    def place(self, step: S) -> StepIndex:
        """Where in the flight a step is."""

    @abstractmethod
    def make(self, seat: UavReplay, step: S) -> Mismatch | None:
        """Make a step; what of it differs from the recording."""

    def take(self, topic: str, log_ns: int, data: bytes) -> None:
        """Note the step of a trigger."""
        uav = self.triggers[topic]
        self._due.append((log_ns, uav, self.read(uav, data)))

    def make_due(self, log_ns: int) -> None:
        """Make the steps that were recorded `WINDOW_NS` before `log_ns`."""
        while self._due and self._due[0][0] < log_ns - WINDOW_NS:
            self._make_first()

    def make_all(self) -> None:
        """Make what is left."""
        while self._due:
            self._make_first()

    def _make_first(self) -> None:
        _, uav, step = self._due.popleft()
        seat = self.desk.seats[uav]
        if seat.account.difference is not None:  # it remembers other things from there on
            return
        try:
            found = self.make(seat, step)
        except WireError as error:
            found = Mismatch("an input", f"unreadable ({error})", "nothing")
        if found is None:
            return
        tick, stamp_ns = self.place(step)
        t_s = self.desk.seconds(stamp_ns)
        seat.account.difference = Difference(
            uav, tick, t_s, stamp_ns, found.field, found.recorded, found.computed, found.difference
        )
