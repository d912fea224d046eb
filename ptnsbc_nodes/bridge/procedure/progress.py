"""Where a flight is and how long for: the memory of a procedure, and the book it keeps."""

from __future__ import annotations

from collections.abc import Callable

from ptnsbc_nodes.bridge.procedure.steps import STOP_S, CommandRequest, Step, VehicleSnapshot

_AGAIN_S = 1.0  # a command without its confirmation is sent again


class FlightProgress:
    """The step of a flight, and what has been seen in it so far."""

    def __init__(self, log: Callable[[str], None]) -> None:
        self._log = log
        self._since_s = float("nan")
        self._asked: dict[CommandRequest, float] = {}
        self._good_since_s: float | None = None
        self.step = Step.HEARTBEAT
        self.fault = ""
        """Why the flight did not go as planned, in the order in which it went wrong."""
        self.before_failsafe = Step.AIRBORNE
        self.grounded_s: float | None = None
        self.confirmed = False  # the mode of a landing was seen
        self.climbed = False
        self.grace_s = float("-inf")

    def begin(self, now_s: float) -> None:
        """The clock of the first step runs from the first look."""
        if self._since_s != self._since_s:
            self._since_s = now_s

    def go(self, step: Step, seen: VehicleSnapshot) -> None:
        """Begin a step."""
        self._log(f"{step.value}{f': {self.fault}' if step is Step.FAILED else ''}")
        self.step = step
        self._since_s = seen.now_s
        self._good_since_s = self.grounded_s = None
        self.confirmed = False
        self._asked.clear()

    def say(self, line: str) -> None:
        """A line for the operator."""
        self._log(line)

    def blame(self, reason: str) -> None:
        """Remember what went wrong, once."""
        if reason not in self.fault:
            self.fault = "; ".join(filter(None, (self.fault, reason)))
        self._log(reason)

    def age(self, seen: VehicleSnapshot) -> float:
        """How long this step has lasted [s]."""
        return seen.now_s - self._since_s

    def lapsed(self, seen: VehicleSnapshot) -> bool:
        """Before arming: whether position or controller went away again."""
        return not seen.state or seen.controller_age_s > STOP_S

    def lasts(self, good: bool, seen: VehicleSnapshot, seconds: float) -> bool:
        """Whether something has been good for so long without a break."""
        if not good:
            self._good_since_s = None
            return False
        if self._good_since_s is None:
            self._good_since_s = seen.now_s
        return seen.now_s - self._good_since_s >= seconds

    def good_for(self, seen: VehicleSnapshot) -> float:
        """How long it has been good [s]."""
        return 0.0 if self._good_since_s is None else seen.now_s - self._good_since_s

    def due(self, ask: CommandRequest | None, seen: VehicleSnapshot) -> CommandRequest | None:
        """The command, when it is time to send it (again)."""
        if ask is None:
            return None
        last = self._asked.get(ask)
        if last is not None and seen.now_s - last < _AGAIN_S:
            return None
        self._asked[ask] = seen.now_s
        return ask
