"""The verdict's tables as HTML: the same rows that the command line prints."""

from __future__ import annotations

from html import escape
from typing import Any

from rich.table import Table
from rich.text import Text

_WORDS = ("met", "missed", "void", "error", "warning")


def _cell(value: Any) -> str:
    plain = value.plain if isinstance(value, Text) else str(value)
    if plain in _WORDS:
        return f'<span class="word {plain}">{escape(plain)}</span>'
    return escape(plain)


def _name(header: Any) -> str:
    return escape(header.plain if isinstance(header, Text) else str(header))


def html_table(table: Table, title: str = "") -> str:
    """A Rich table as an HTML table in a box that scrolls by itself; `title` replaces its own."""
    sides = ["number" if column.justify == "right" else "text" for column in table.columns]
    head = "".join(
        f'<th scope="col" class="{side}">{_name(column.header)}</th>'
        for side, column in zip(sides, table.columns, strict=True)
    )
    rows = []
    for row, *cells in zip(table.rows, *(column.cells for column in table.columns), strict=True):
        look = ' class="bad"' if row.style else ""
        inside = "".join(
            f'<td class="{side}">{_cell(cell)}</td>'
            for side, cell in zip(sides, cells, strict=True)
        )
        rows.append(f"<tr{look}>{inside}</tr>")
    title = _name(title or table.title or "")
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{title}"><table>'
        f"<caption>{title}</caption><thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )
