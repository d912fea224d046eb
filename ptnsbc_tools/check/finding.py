"""One result of the pre-flight check."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ptnsbc_core.errors import PtnsbcError

ERROR, WARNING, INFO = "error", "warning", "info"


class CheckError(PtnsbcError):
    """A scenario that the pre-flight check refuses."""


@dataclass(frozen=True)
class Finding:
    """One result: what was found at a key, its limit, and what to change."""

    severity: str  # error | warning | info
    key: str
    value: str
    limit: str
    advice: str

    def __str__(self) -> str:
        """In one line, behind the name of the scenario."""
        return f"{self.key}: {self.value}: expected {self.limit}; {self.advice}"


def judge(key: str, value: str, limit: str, advice: str = "", severity: str = WARNING) -> Finding:
    """A finding: of the severity where there is something to change, else good to know."""
    return Finding(severity if advice else INFO, key, value, limit, advice)


Findings = Iterator[Finding]
