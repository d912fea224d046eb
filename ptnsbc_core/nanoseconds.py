"""Stamps and periods are whole nanoseconds; the laws compute in seconds. Kernels and Python convert by the same two."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, overload

from ptnsbc_core.kernel import formula

if TYPE_CHECKING:
    from ptnsbc_core.types import Array

SECOND_NS = 1_000_000_000


@overload
def seconds(ns: int) -> float: ...


@overload
def seconds(ns: Any) -> Array: ...


@formula
def seconds(ns: Any) -> Any:
    """Nanoseconds, a number or an array of any shape, in seconds."""
    return ns * 1e-9


def nanoseconds(s: float) -> int:
    """Seconds in whole nanoseconds."""
    return round(s * 1e9)
