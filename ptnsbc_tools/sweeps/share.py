"""A share of flights with its interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

WIDE = 0.2
"""An interval wider than this is called wide."""


@dataclass(frozen=True)
class Share:
    """`count` of `of`, and the Wilson interval of the probability at 95 %."""

    count: int
    of: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The share itself; NaN of nothing."""
        return self.count / self.of if self.of else float("nan")

    @property
    def wide(self) -> bool:
        """True if the interval says little: fly more."""
        return self.high - self.low > WIDE

    @property
    def interval(self) -> str:
        """`43.3 to 81.9 %`; one bound where the count is none or all."""
        digits = 1 if self.high - self.low > 0.01 else 3
        if self.count == 0:
            return f"at most {100 * self.high:.{digits}f} %"
        if self.count == self.of:
            return f"at least {100 * self.low:.{digits}f} %"
        return f"{100 * self.low:.1f} to {100 * self.high:.1f} %"

    def __str__(self) -> str:
        if not self.of:
            return "0 of 0"
        wide = ", wide" if self.wide else ""
        return f"{self.count} of {self.of}, {100 * self.value:.1f} % ({self.interval}{wide})"

    def as_json(self) -> dict[str, Any]:
        """As plain data; null where there are no flights."""
        value = self.value if self.of else None
        return {
            "count": self.count,
            "of": self.of,
            "share": value,
            "low": self.low,
            "high": self.high,
            "wide": self.wide,
        }


def share(count: int, of: int) -> Share:
    """A share with its Wilson interval."""
    from scipy.stats import binomtest

    if not of:
        return Share(0, 0, 0.0, 1.0)
    found = binomtest(count, of).proportion_ci(method="wilson")
    return Share(count, of, float(found.low), float(found.high))


def share_of(met: NDArray[np.bool_]) -> Share:
    """The share of True."""
    return share(int(np.sum(met)), len(met))
