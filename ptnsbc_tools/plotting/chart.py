"""A figure over time as plain data, for Matplotlib and for the page alike."""

from __future__ import annotations

from dataclasses import dataclass

from ptnsbc_core.types import Array
from ptnsbc_tools.plotting.style import Look


@dataclass(frozen=True)
class Curve:
    """One quantity over time."""

    label: str
    look: Look
    t: Array  # (T,) [s] after the epoch
    values: Array  # (T,)
    uavs: tuple[int, ...]  # whom it is about: switched off with any of them


@dataclass(frozen=True)
class Limit:
    """A horizontal line that something must stay below or above."""

    value: float
    label: str


@dataclass(frozen=True)
class Mark:
    """A vertical line."""

    t: float  # [s] after the epoch
    label: str


@dataclass(frozen=True)
class Span:
    """A shaded span of time."""

    begin: float  # [s] after the epoch
    end: float


@dataclass(frozen=True)
class Chart:
    """Everything in one set of axes."""

    key: str  # its name on the command line, and of its file
    title: str
    unit: str
    curves: tuple[Curve, ...]
    log: bool = False
    limits: tuple[Limit, ...] = ()
    marks: tuple[Mark, ...] = ()
    band: tuple[float, float] | None = None  # of values that are good
    spans: tuple[Span, ...] = ()  # of time in which the error is excused for somebody
    note: str = ""

    @property
    def quantity(self) -> str:
        """What the vertical axis shows."""
        name = self.title.split(":")[-1].split(",")[0].strip()
        return name[:1].lower() + name[1:]
