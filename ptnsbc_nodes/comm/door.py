"""The guarded entrance of a node: bytes of one topic in, a decoded message or nothing out.

Every subscription has a `Door`. A message that is too large, cannot be decoded, is not finite, is out of range,
comes from other frames or carries an impossible stamp is refused: counted, named on /diagnostics, and forgotten.
Nothing that arrives raises into the executor.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_io.wire import Stamped, WireError, peek_stamp

T = TypeVar("T")
S = TypeVar("S", bound=Stamped)

LARGEST_MESSAGE = 1 << 20
"""Bytes: a topic of the formation carries some kilobytes at most."""
AHEAD_S = 1.0
"""Real time: a stamp that is farther in the future is refused. Clocks that differ by less are named by the UAV."""
OLDEST_S = 10.0
"""Real time: a message that is older is refused."""
FORGET_S = 0.5
"""Real time: after so long without a message of a sender its order begins anew: its clock may have been set back."""
_LONGEST_REASON = 160


class RepetitionError(WireError):
    """A message with the stamp of the one before: it has nothing new, and nothing is wrong with its sender."""


class LockstepStamps:
    """Lock-step: stamps of one sender rise, are multiples of the period, and are at most some ticks ahead.

    Args:
        latest_ns: the latest stamp that any sender can have reached.
        period_ns: the control period.
    """

    __slots__ = ("_latest_ns", "_newest_ns", "_period_ns")

    def __init__(self, latest_ns: Callable[[], int], period_ns: int) -> None:
        self._latest_ns = latest_ns
        self._period_ns = period_ns
        self._newest_ns = -1

    def check(self, stamp_ns: int) -> None:
        """Raise WireError when the stamp is refused."""
        self.look(stamp_ns)
        self._newest_ns = stamp_ns

    def look(self, stamp_ns: int) -> None:
        """As `check`, of a message that is not taken: one of the same stamp may still be."""
        if stamp_ns <= self._newest_ns:
            raise WireError(f"stamp {stamp_ns} ns is not after {self._newest_ns} ns")
        if stamp_ns > self._latest_ns():
            raise WireError(f"stamp {stamp_ns} ns is in the future")
        if stamp_ns % self._period_ns:
            raise WireError(f"stamp {stamp_ns} ns is no multiple of {self._period_ns} ns")


class RealTimeStamps:
    """Real time: stamps of one sender rise, are not old, and not in the future of the node's clock.

    Args:
        now_ns: the clock that stamps are compared with.
        steady_s: the time of arrival.
    """

    __slots__ = ("_accepted_s", "_newest_ns", "_now_ns", "_steady_s")

    def __init__(
        self, now_ns: Callable[[], int], steady_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._now_ns = now_ns
        self._steady_s = steady_s
        self._newest_ns = -1
        self._accepted_s = float("-inf")

    def check(self, stamp_ns: int) -> None:
        """Raise WireError when the stamp is refused."""
        clock_ns, now_s = self._now_ns(), self._steady_s()
        # A simulated clock stands at 0 until its first message.
        age_s = seconds(clock_ns - stamp_ns) if clock_ns else 0.0
        if age_s > OLDEST_S:
            raise WireError(f"stamp is {age_s:.1f} s old: expected {OLDEST_S:g} s at most")
        if age_s < -AHEAD_S:
            raise WireError(
                f"stamp is {-age_s:.1f} s in the future: expected {AHEAD_S:g} s at most"
            )
        if stamp_ns <= self._newest_ns and now_s - self._accepted_s < FORGET_S:
            if stamp_ns == self._newest_ns:  # a UAV that was late ticks twice with one odometry
                raise RepetitionError(f"stamp {stamp_ns} ns again")
            behind_ms = (self._newest_ns - stamp_ns) * 1e-6
            raise WireError(f"stamp is {behind_ms:.3f} ms before that of an earlier message")
        self._newest_ns, self._accepted_s = stamp_ns, now_s


class Refusals:
    """The messages that the doors of one node have refused."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()  # by topic
        self.newest = ""  # topic and reason
        self._reported = 0

    def add(self, topic: str, reason: str) -> None:
        """Count one message; the reason may hold words of its sender."""
        self.counts[topic] += 1
        shown = "".join(c if c.isprintable() else "?" for c in reason[:_LONGEST_REASON])
        self.newest = f"{topic}: {shown}"

    def values(self) -> dict[str, str]:
        """For /diagnostics; empty as long as nothing was refused."""
        if not self.counts:
            return {}
        counts = " ".join(f"{topic}={count}" for topic, count in sorted(self.counts.items()))
        return {"refused": counts, "refused_newest": self.newest}

    def report(self) -> str:
        """The messages refused since the last report, as a warning; empty without any."""
        total = sum(self.counts.values())
        new, self._reported = total - self._reported, total
        return f"{new} messages refused: {self.newest}" if new else ""


class Door(Generic[T]):
    """The callback of one subscription to `topic`: a PtnsbcError of `decode` refuses a message.

    `after` is called after each message, refused or not.
    """

    __slots__ = ("_after", "_decode", "_deliver", "_largest", "_refusals", "_topic")

    def __init__(
        self,
        topic: str,
        decode: Callable[[bytes], T],
        deliver: Callable[[T], None],
        refusals: Refusals,
        largest: int = LARGEST_MESSAGE,
        after: Callable[[], None] = lambda: None,
    ) -> None:
        self._topic, self._largest, self._refusals = topic, largest, refusals
        self._decode, self._deliver, self._after = decode, deliver, after

    def __call__(self, data: bytes) -> None:
        """Deliver the message, or refuse it."""
        try:
            if len(data) > self._largest:
                raise WireError(f"{len(data)} bytes: expected {self._largest} at most")
            message = self._decode(data)
        except RepetitionError:
            pass
        except PtnsbcError as error:
            self._refusals.add(self._topic, str(error))
        else:
            self._deliver(message)
        self._after()


class RefusedMessage(NamedTuple):
    """A message that cannot be used, of which the stamp is known."""

    stamp_ns: int
    reason: str


def in_lockstep(
    decode: Callable[[bytes], Stamped], rule: LockstepStamps
) -> Callable[[bytes], Stamped | RefusedMessage]:
    """A decoder that refuses by the stamp, and keeps the stamp of a message that it refuses for another reason."""

    def decode_in_lockstep(data: bytes) -> Stamped | RefusedMessage:
        try:
            message = decode(data)
        except WireError as error:
            refused = RefusedMessage(peek_stamp(data), str(error))
            rule.look(refused.stamp_ns)
            return refused
        rule.check(message.stamp_ns)
        return message

    return decode_in_lockstep


def in_order(
    decode: Callable[[bytes], S], rule: LockstepStamps | RealTimeStamps
) -> Callable[[bytes], S]:
    """A decoder that also refuses by the stamp."""
    check = rule.check

    def decode_in_order(data: bytes) -> S:
        message = decode(data)
        check(message.stamp_ns)
        return message

    return decode_in_order


def as_bytes(decode: Callable[[bytes], object]) -> Callable[[bytes], bytes]:
    """A decoder that checks a message and passes its bytes on."""

    def check(data: bytes) -> bytes:
        decode(data)
        return data

    return check
