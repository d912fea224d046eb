"""The legs of a flight as the leader announces them: the instant from which each mode holds."""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import LEGS, MODE_FORMATION, MODE_LAND, Array
from ptnsbc_io.wire import Stamped
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.fault_rules import NEVER_NS
from ptnsbc_sim.scenario.mission.legs import Word, number_of
from ptnsbc_sim.scenario.mission.stream import SetpointError, setpoint_of

FIRST_LEG = "form"
_MOST_LEGS = 256  # that are remembered


class EpochError(PtnsbcError):
    """An epoch that no UAV can fly."""


class Leg(NamedTuple):
    """The leg in force at some instant."""

    name: str  # a key of LEGS
    mode: int  # MODE_*
    t0_ns: int  # its epoch: every time base counts from here [ns]
    first_t0_ns: int  # epoch of the first leg [ns]


class Epochs:
    """The announced legs, in the order of their announcement, and what was said of the legs of a mission."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario  # as its mission goes on after what was said
        self._legs: list[Leg] = []
        self._landing_ns = scenario.landing_ns

    def announce(self, t0_ns: int, name: str) -> bool:
        """Add a leg; returns False for one that is known, which the latched topic may repeat."""
        number = number_of(name)
        if number is not None:
            return self._take_word(t0_ns, number)
        if name not in LEGS:
            raise EpochError(f"epoch with leg {name!r}: expected one of {', '.join(LEGS)}")
        first_t0_ns = self._legs[0].t0_ns if self._legs else t0_ns
        leg = Leg(name, LEGS[name], t0_ns, first_t0_ns)
        if leg in self._legs:
            return False
        self._legs.append(leg)
        if len(self._legs) > _MOST_LEGS:
            del self._legs[1]  # the first one is where the flight counts from
        return True

    def word(self, t0_ns: int, number: int) -> Word:
        """A word that counts from `t0_ns`; a leg must have been announced."""
        return Word(number, seconds(t0_ns - self._legs[0].first_t0_ns))

    def _take_word(self, t0_ns: int, number: int) -> bool:
        """Begin a leg of the mission, or cancel the present one; False where that means nothing, or is known."""
        scenario = self.scenario
        mission = scenario.mission
        if mission is None or not self._legs or number > len(mission.legs):
            return False
        words, word = scenario.words, self.word(t0_ns, number)
        if words and word.at_s <= words[-1].at_s:
            return False
        try:
            self.scenario = scenario.with_words((*words, word))
        except PtnsbcError:  # the leader has refused it
            return False
        self._landing_ns = self.scenario.landing_ns
        return True

    def following(self, now_ns: int, odometry: Array) -> Scenario:
        """The scenario whose leader follows one more setpoint (13,) from `now_ns` on; EpochError if it cannot."""
        leg = self.at(now_ns)
        if leg is None or leg.mode != MODE_FORMATION:
            raise EpochError("setpoint: expected one while the formation is flown")
        one = setpoint_of(seconds(now_ns - leg.first_t0_ns), odometry)
        try:
            return self.scenario.with_setpoint(one)
        except SetpointError as error:
            raise EpochError(f"setpoint: {error}") from None

    def take(self, taken: Stamped) -> None:
        """Follow a setpoint that the leader has taken; without effect where that means nothing."""
        try:
            self.scenario = self.following(taken.stamp_ns, taken.values)
        except EpochError:
            return

    @property
    def announced(self) -> bool:
        """True if any leg is known, also one in the future."""
        return bool(self._legs)

    @property
    def first_t0_ns(self) -> int | None:
        """The epoch of the first leg; None before one is announced."""
        return self._legs[0].t0_ns if self._legs else None

    def at(self, now_ns: int, uav_id: int | None = None) -> Leg | None:
        """The leg in force: of those whose epoch has come, the one announced last.

        So an immediate stop wins over a hold that was announced before it for a later instant. The landing of the
        mission, and that of the UAV `uav_id` when it leaves, follow a leg in formation that began before them.
        """
        for leg in reversed(self._legs):
            if leg.t0_ns <= now_ns:
                return self._landing(leg, now_ns, uav_id) or leg
        return None

    def _landing(self, leg: Leg, now_ns: int, uav_id: int | None) -> Leg | None:
        """The landing of the mission, or of a UAV that leaves, when it has begun in this leg."""
        if leg.mode != MODE_FORMATION:
            return None
        since_ns = NEVER_NS if self._landing_ns is None else self._landing_ns
        if uav_id is not None:
            since_ns = min(since_ns, self.scenario.uav(uav_id).leaves_ns)
        t0_ns = leg.first_t0_ns + since_ns
        if not leg.t0_ns <= t0_ns <= now_ns:
            return None
        return Leg("land", MODE_LAND, t0_ns, leg.first_t0_ns)
