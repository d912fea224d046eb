"""The other vehicles before the flight: whether all are ready, armed, and stand where they may climb.

Bridges report to each other on /diagnostics. No vehicle arms before all are ready, and none climbs before all are
armed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from ptnsbc_nodes.bridge.procedure.steps import Step

HEARD_S = 2.0
"""A report that is older does not count."""

_UP = (Step.TAKEOFF, Step.AIRBORNE, Step.FLY)
_ARMED = frozenset(step.value for step in (Step.ARMED, *_UP))
_READY = frozenset(step.value for step in (Step.READY, Step.ARM, Step.ARMED, *_UP))
_OUT = frozenset(step.value for step in (Step.FAILED, Step.DONE, Step.YIELDED, Step.DISARM))
_CLEAR_M = 1.5  # a vehicle so high above the ground has left room for the next one to lift off

Position = tuple[float, float, float]


class Companion(NamedTuple):
    """The report of the bridge of another vehicle."""

    step: str
    fault: str
    position: Position | None  # in the world [m]
    error_m: float  # of that position, horizontally
    height_m: float  # above the place of arming


class StandingPlace(NamedTuple):
    """The place where a vehicle stands, and its uncertainty."""

    position: Position
    error_m: float


class Companions:
    """The reports of all other bridges."""

    def __init__(
        self,
        uav_id: int,
        awaited: frozenset[int],
        keep_outs_m: Mapping[int, float],
        spacing_m: float,
    ) -> None:
        """Args:
        uav_id: the own id.
        awaited: ids that must be heard; others count once they are heard.
        keep_outs_m: distance that this vehicle and another must keep, by the id of the other.
        spacing_m: vehicles that stand nearer than the keep-out and this do not climb side by side.
        """
        self._uav_id = uav_id
        self._awaited = awaited - {uav_id}
        self._keep_outs_m, self._spacing_m = keep_outs_m, spacing_m
        self._heard: dict[int, tuple[Companion, float]] = {}

    def report(self, uav_id: int, companion: Companion, now_s: float) -> None:
        """Take a report."""
        if uav_id != self._uav_id:
            self._heard[uav_id] = (companion, now_s)

    def not_ready(self, now_s: float) -> str:
        """The vehicles that are not ready to arm; empty when all are."""
        return ", ".join(self._missing(_READY, now_s))

    def not_armed(self, now_s: float) -> str:
        """The vehicles that are not armed; empty when all are."""
        return ", ".join(self._missing(_ARMED, now_s))

    def out(self) -> str:
        """The vehicles that will not fly, and why; empty while all may."""
        for uav_id, (companion, _) in sorted(self._heard.items()):
            if companion.step in _OUT:
                why = f": {companion.fault}" if companion.fault else ""
                return f"bridge{uav_id} {companion.step}{why}"
        return ""

    def too_near(self, place: StandingPlace) -> str:
        """The reason why this vehicle may not arm where it stands; empty when it may."""
        for uav_id, _, apart_m, error_m in self._apart(place):
            keep_out_m = self._keep_outs_m[uav_id]
            least_m = keep_out_m + error_m
            if apart_m < least_m:
                return (
                    f"stands {apart_m:.2f} m from the vehicle of bridge{uav_id}: expected at least {least_m:.2f} m, "
                    f"the keep-out of {keep_out_m:g} m and {error_m:.2f} m of position error"
                )
        return ""

    def climbs_first(self, place: StandingPlace) -> str:
        """The vehicles that must climb before this one, because both stand close; empty when it may climb."""
        waits = (
            f"bridge{uav_id}"
            for uav_id, other, apart_m, error_m in self._apart(place)
            if uav_id < self._uav_id
            and apart_m < self._keep_outs_m[uav_id] + self._spacing_m + error_m
            and other.height_m < _CLEAR_M
        )
        return ", ".join(waits)

    def _apart(self, place: StandingPlace) -> Iterator[tuple[int, Companion, float, float]]:
        """The others with the horizontal distance to each and the error of that distance [m]."""
        for uav_id, (other, _) in sorted(self._heard.items()):
            if other.position is not None:
                apart_m = math.dist(place.position[:2], other.position[:2])
                yield uav_id, other, apart_m, math.hypot(place.error_m, other.error_m)

    def _missing(self, steps: frozenset[str], now_s: float) -> Iterator[str]:
        for uav_id in sorted(self._awaited | set(self._heard)):
            companion, heard_s = self._heard.get(uav_id, (None, -math.inf))
            if companion is None or now_s - heard_s > HEARD_S:
                yield f"bridge{uav_id} (not heard)"
            elif companion.step not in steps:
                yield f"bridge{uav_id} ({companion.step})"
