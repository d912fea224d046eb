"""The legs of a flight as the leader announces them: the instant from which each mode holds."""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import LEGS, MODE_FORMATION, MODE_LAND

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
    """The announced legs, in the order of their announcement.

    Args:
        landing_ns: when the mission of the scenario lands, after the first epoch [ns]; None: never.
    """

    def __init__(self, landing_ns: int | None = None) -> None:
        self._legs: list[Leg] = []
        self._landing_ns = landing_ns

    def announce(self, t0_ns: int, name: str) -> bool:
        """Add a leg; returns False for one that is known, which the latched topic may repeat."""
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

    @property
    def announced(self) -> bool:
        """Whether any leg is known, also one in the future."""
        return bool(self._legs)

    @property
    def first_t0_ns(self) -> int | None:
        """The epoch of the first leg; None before one is announced."""
        return self._legs[0].t0_ns if self._legs else None

    def at(self, now_ns: int) -> Leg | None:
        """The leg in force: of those whose epoch has come, the one announced last.

        So an immediate stop wins over a hold that was announced before it for a later instant. The landing of the
        mission follows a leg in formation that began before it.
        """
        for leg in reversed(self._legs):
            if leg.t0_ns <= now_ns:
                return self._landing(leg, now_ns) or leg
        return None

    def _landing(self, leg: Leg, now_ns: int) -> Leg | None:
        """The landing of the mission, when it has begun in this leg."""
        if self._landing_ns is None or leg.mode != MODE_FORMATION:
            return None
        t0_ns = leg.first_t0_ns + self._landing_ns
        if not leg.t0_ns <= t0_ns <= now_ns:
            return None
        return Leg("land", MODE_LAND, t0_ns, leg.first_t0_ns)
