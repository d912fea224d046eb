"""Re-run of a lock-step or headless bag: what went into tick k follows from the rule (docs/lockstep.md)."""

from __future__ import annotations

from ptnsbc_io.wire import WireError, peek_stamp
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.uav.controller import step_time
from ptnsbc_tools.replay.difference import Mismatch
from ptnsbc_tools.replay.driver import Driver, StepIndex
from ptnsbc_tools.replay.replay_state import ReplayState
from ptnsbc_tools.replay.uav_replay import MissingError, UavReplay


class Lockstep(Driver[int]):
    """A step is the stamp of an own odometry."""

    def __init__(self, desk: ReplayState) -> None:
        super().__init__(desk)
        self.triggers = {topics.odom(uav).name: uav for uav in desk.seats}
        self._period_ns = desk.scenario.dt_ns
        self._near_every = desk.scenario.near_every
        self._next_ns = dict.fromkeys(desk.seats, 0)
        self._lost: dict[int, str] = {}  # why a UAV cannot be followed any more

    def read(self, uav: int, data: bytes) -> int:
        """The stamp; WireError when simulated time cannot have made it."""
        stamp_ns = peek_stamp(data)
        if stamp_ns % self._period_ns:
            raise WireError(
                f"stamp {stamp_ns} ns is no multiple of the period {self._period_ns} ns: expected "
                f"lock-step, or {topics.tick(uav).name} of real time in the bag"
            )
        return stamp_ns

    def place(self, step: int) -> StepIndex:
        """Ticks are counted from simulated time 0."""
        return StepIndex(step // self._period_ns, step)

    def make(self, seat: UavReplay, step: int) -> Mismatch | None:
        """The step at `step` [ns], from the messages of the tick before."""
        leg = self.desk.epochs.at(step)
        if leg is None:
            return None
        why = self._lost.get(seat.uav)
        if why is None:
            try:
                self._fetch(seat, step)
            except MissingError as missing:
                self._lost[seat.uav] = why = str(missing)
        if why is not None:
            seat.account.skip(self.desk.seconds(step), 1, why)
            return None
        outputs = seat.step(step_time(step, self._period_ns, leg, 0), step)
        found = seat.compare(outputs, self.desk.shelves)
        return found or seat.compare_counters()

    def _fetch(self, seat: UavReplay, now_ns: int) -> None:
        """Put what the tick was made of into the inbox."""
        expected_ns = self._next_ns[seat.uav]
        if now_ns != expected_ns:
            raise MissingError(f"{seat.inputs['own'].name} stamped {expected_ns} is not recorded")
        self._next_ns[seat.uav] = now_ns + self._period_ns
        tick = now_ns // self._period_ns
        last_near = (tick - tick % self._near_every) * self._period_ns
        for name, topic in seat.inputs.items():
            if name == "own":
                self._hold(seat, name, topic.name, now_ns)
            elif name == "near":
                self._hold(seat, name, topic.name, last_near)
            elif now_ns > 0:
                self._hold(seat, name, topic.name, now_ns - self._period_ns)

    def _hold(self, seat: UavReplay, name: str, topic: str, due_ns: int) -> None:
        """The message that is due; an older one only of a UAV that has ended."""
        shelf = self.desk.shelves[topic]
        due = shelf.read(due_ns)
        if due:
            seat.hold(name, due[-1])
            return
        if name in ("own", "near") or shelf.newest_ns >= due_ns:
            raise MissingError(f"{topic} stamped {due_ns} is not recorded")
        last = shelf.before(due_ns)
        if last is not None:
            seat.hold(name, last)
