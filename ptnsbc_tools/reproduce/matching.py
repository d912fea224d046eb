"""The nominal deadline at which a law really settles at a given time: those laws promise late and come early."""

from __future__ import annotations

from collections.abc import Callable

from ptnsbc_tools.reproduce.part import ReproduceError

_GROWTH, _LARGEST = 1.5, 20.0
_STEPS = 12
_CLOSE = 0.01  # of the time wanted


def deadline_for(settled_s: Callable[[float], float | None], wanted_s: float) -> float:
    """The nominal deadline [s] whose flight settles at `wanted_s`, to one percent where it can be.

    Args:
        settled_s: settling time of a flight by its nominal deadline; None when it never settles.
        wanted_s: the time to match.

    Raises:
        ReproduceError: no nominal deadline up to twenty times as long settles that late.
    """
    low = high = wanted_s
    while not _late(settled_s(high), wanted_s):
        low, high = high, high * _GROWTH
        if high > _LARGEST * wanted_s:
            raise ReproduceError(f"nothing settles at {wanted_s:.2f} s: expected a slower law")
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        found = settled_s(middle)
        if found is not None and abs(found - wanted_s) <= _CLOSE * wanted_s:
            return middle
        low, high = (low, middle) if _late(found, wanted_s) else (middle, high)
    return low


def _late(found: float | None, wanted_s: float) -> bool:
    return found is None or found > wanted_s
