"""Markdown tables, and the regions of a page that are made."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

_REGION = re.compile(r"(<!-- made: ([\w.-]+) -->\n)(.*?)(<!-- /made -->)", re.DOTALL)


class RegionError(Exception):
    """A page and its generator do not name the same regions."""


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table with one line a row; a bar inside a cell is escaped."""
    lines = [_line(headings), "|" + "---|" * len(headings)]
    return "\n".join([*lines, *(_line(row) for row in rows)]) + "\n"


def _line(cells: Sequence[str]) -> str:
    escaped = (" ".join(cell.split()).replace("|", "\\|") for cell in cells)
    return "".join(f"| {cell} " if cell else "| " for cell in escaped) + "|"


def region(page: str, name: str) -> str:
    """The text of a `made` region of a page."""
    return next(found[3] for found in _REGION.finditer(page) if found[2] == name).strip()


def remade(page: str, regions: Mapping[str, str]) -> str:
    """The text of a page with each `made` region in it filled anew; the rest is left alone."""
    named = [found[2] for found in _REGION.finditer(page)]
    if sorted(named) != sorted(regions):
        raise RegionError(f"regions {', '.join(named)}: expected {', '.join(regions)}, each once")
    return _REGION.sub(lambda found: f"{found[1]}\n{regions[found[2]].strip()}\n\n{found[4]}", page)
