"""Re-run of a real-time bag: each UAV noted what its steps were made of (`ptnsbc_nodes.uav.step_log`)."""

from __future__ import annotations

from ptnsbc_io.wire import decode_integers
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.uav.step_log import TickNote, tick_note
from ptnsbc_tools.replay.difference import Mismatch
from ptnsbc_tools.replay.driver import Driver, StepIndex
from ptnsbc_tools.replay.replay_state import ReplayState
from ptnsbc_tools.replay.uav_replay import MissingError, UavReplay

_KEPT_STAMPS = 2000  # per UAV: several seconds


class Realtime(Driver[TickNote]):
    """A step is a note."""

    def __init__(self, desk: ReplayState) -> None:
        super().__init__(desk)
        self.triggers = {topics.tick(uav).name: uav for uav in desk.seats}
        self._sent: dict[int, dict[int, int]] = {uav: {} for uav in desk.seats}  # steps by stamp
        self._why = dict.fromkeys(desk.seats, "the recording begins after the first step")

    def read(self, uav: int, data: bytes) -> TickNote:
        """The note; all outputs of its step carry the stamp of its own odometry."""
        row = decode_integers(data)
        note = tick_note(row.label, row.values.tolist())
        sent = self._sent[uav]
        own_ns = note.used["own"].stamp_ns
        sent[own_ns] = sent.get(own_ns, 0) + 1
        if len(sent) > _KEPT_STAMPS:
            del sent[next(iter(sent))]
        return note

    def place(self, step: TickNote) -> StepIndex:
        """Ticks are counted by the process."""
        return StepIndex(step.sequence, step.moment.now_ns)

    def make(self, seat: UavReplay, step: TickNote) -> Mismatch | None:
        """The step of a note, if the pilot has made all before it."""
        snapshot = self.desk.snapshot(seat.uav, step.sequence)
        if step.sequence == 0:  # the controller has begun, or begins anew
            seat.begin(snapshot)
        expected = seat.next_step
        if expected != step.sequence:
            if expected is not None:
                self._why[seat.uav] = f"notes on {topics.tick(seat.uav).name} are not recorded"
                self._skip(seat, step, step.sequence - expected)
            self._leave_out(seat, step, snapshot)
            return None
        try:
            wrong = seat.fetch(step, self.desk.shelves)
        except MissingError as missing:
            self._why[seat.uav] = str(missing)
            self._leave_out(seat, step, snapshot)
            return None
        outputs = seat.step(step.moment)
        own_ns = step.used["own"].stamp_ns
        expected = self._sent[seat.uav].get(own_ns, 1)
        found = wrong or seat.compare(outputs, self.desk.shelves, expected)
        found = found or seat.compare_counters()
        if found is None and snapshot is not None:
            found = seat.compare_snapshot(step.sequence, snapshot)
        return found

    def _leave_out(self, seat: UavReplay, step: TickNote, snapshot: bytes | None) -> None:
        """Do not make a step; go on behind it if there is a snapshot."""
        self._skip(seat, step, 1)
        seat.lose_thread()
        if snapshot is not None:
            seat.resume(step.sequence, snapshot)

    def _skip(self, seat: UavReplay, step: TickNote, steps: int) -> None:
        if step.moment.flying:
            t_s = self.desk.seconds(step.moment.now_ns)
            seat.account.skip(t_s, steps, self._why[seat.uav])
        else:
            seat.account.waiting += steps
