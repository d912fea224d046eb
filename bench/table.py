"""Rows of the result: a figure, its reference, its target; as Markdown, as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

HEADINGS = ("figure", "measured", "runs", "reference", "ratio", "target", "met")


@dataclass(frozen=True)
class Target:
    """The value that a figure should reach; it decides a column of the table and nothing else."""

    limit: float
    at_least: bool = False
    of_reference: bool = False  # the limit is for figure / reference

    def met(self, row: Row) -> bool:
        """True if the figure of `row` reaches it."""
        found = (row.ratio or 0.0) if self.of_reference else row.value
        return found >= self.limit if self.at_least else found <= self.limit

    def text(self, unit: str) -> str:
        """Like `≤ 30 µs`."""
        sign = "≥" if self.at_least else "≤"
        if self.of_reference:
            return f"{sign} {100 * self.limit:.0f} % of ref."
        return f"{sign} {number(self.limit)} {unit}"


@dataclass(frozen=True)
class Row:
    """One figure: what it was in every run, beside what the reference was just before."""

    figure: str
    values: Sequence[float]
    unit: str
    reference: str = ""  # what was run beside it
    references: Sequence[float] = ()
    reference_unit: str = ""  # the figure's own when empty
    target: Target | None = None
    section: str = ""

    @property
    def value(self) -> float:
        """Median of the runs."""
        return median(self.values)

    @property
    def ratio(self) -> float | None:
        """Median of figure / reference, run by run: both saw the same load."""
        pairs = list(zip(self.values, self.references, strict=False))
        if self.reference_unit not in ("", self.unit) or not pairs:
            return None
        if any(other == 0.0 for _, other in pairs):
            return None
        return median(own / other for own, other in pairs)

    @property
    def met(self) -> bool | None:
        """True if the target is reached; None without one."""
        return None if self.target is None else self.target.met(self)

    def as_json(self) -> dict[str, Any]:
        """Every field, plain."""
        return {
            "section": self.section,
            "figure": self.figure,
            "value": self.value,
            "unit": self.unit,
            "runs": list(self.values),
            "reference": self.reference or None,
            "reference_value": median(self.references) if self.references else None,
            "reference_unit": (self.reference_unit or self.unit) if self.references else None,
            "ratio": self.ratio,
            "target": self.target.text(self.unit) if self.target else None,
            "met": self.met,
        }

    def cells(self) -> tuple[str, ...]:
        """The row as text, one cell per heading."""
        runs = "" if len(self.values) < 2 else f"{_span(self.values)} ({len(self.values)})"
        reference = self.reference
        if self.references:
            unit = self.reference_unit or self.unit
            reference = f"{number(median(self.references))} {unit}, {self.reference}"
        return (
            self.figure,
            f"{number(self.value)} {self.unit}",
            runs,
            reference,
            "" if self.ratio is None else f"{self.ratio:.2f}",
            self.target.text(self.unit) if self.target else "",
            {None: "", True: "yes", False: "NO"}[self.met],
        )


def number(value: float) -> str:
    """Three significant digits, without an exponent."""
    size = abs(value)
    if size >= 100:
        return f"{value:,.0f}"
    digits = 1 if size >= 10 else 2 if size >= 1 else 3
    return f"{value:.{digits}f}"


def _span(values: Sequence[float]) -> str:
    return f"{number(min(values))} – {number(max(values))}"


def markdown(rows: Sequence[Row], facts: Sequence[str]) -> str:
    """For the documentation: what it was measured on, and the table."""
    lines = [f"- {fact}" for fact in facts] + [""]
    lines += [_line(HEADINGS), _line(["---"] * len(HEADINGS))]
    lines += [_line(row.cells()) for row in rows]
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
