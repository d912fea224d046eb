"""The page of a sweep, and that of a comparison: one HTML file each that works offline."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from html import escape
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory

from rich.table import Table

from ptnsbc_io.files import replacing
from ptnsbc_tools.plotting.draw import save
from ptnsbc_tools.report.page import asset, html_table
from ptnsbc_tools.sweeps import comparison, summary
from ptnsbc_tools.sweeps.comparison import SweepComparison
from ptnsbc_tools.sweeps.figures import figures, paired
from ptnsbc_tools.sweeps.table import FlightTable, FlownSweep

FOLDER = "report"

_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="ptnsbc $command">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>$name – $command</title>
<style>
$style
figure { margin: 0 0 16px; } figure img { max-width: 100%; background: white; border-radius: 12px; }
figcaption { color: var(--soft); font-size: 13px; }
</style>
</head>
<body>
<header class="top"><div><p class="kicker">$kicker</p><h1>$name</h1></div></header>
<main>
<p>$heading</p>
<p><b>$line</b></p>
$tables
$more
</main>
</body>
</html>
""")


def _picture(caption: str, path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    shown = escape(caption)
    return (
        f'<figure><img alt="{shown}" src="data:image/png;base64,{data}">'
        f"<figcaption>{shown}</figcaption></figure>"
    )


def _write(path: Path, command: str, name: str, heading: str, line: str,
           tables: Iterable[Table], more: str) -> Path:  # fmt: skip
    text = _PAGE.substitute(
        command=command,
        kicker=command.capitalize(),
        name=escape(name),
        heading=escape(heading),
        style=asset("style.css"),
        line=escape(line),
        tables="\n".join(html_table(table) for table in tables),
        more=more,
    )
    with replacing(path, folder=True) as part:
        part.write_text(text, encoding="utf-8")
    return path


def write_report(sweep: FlownSweep) -> Path:
    """Write the page and the figures into `report/` of the sweep's folder; returns the page."""
    folder = sweep.folder / FOLDER
    pictures = [
        _picture(one.caption, save(one.figure, folder / f"{one.name}.png"))
        for one in figures(sweep)
    ]
    commands = "\n".join(one.command for one in summary.worst(sweep))
    more = (
        f"<p>These commands fly them again:</p>\n<pre>{escape(commands)}</pre>\n"
        + "\n".join(pictures)
        + f"\n<details><summary>Plan</summary><pre>{escape(sweep.plan.to_json())}</pre></details>"
    )
    line = summary.line(sweep).plain
    return _write(
        folder / "index.html", "sweep", sweep.plan.name, summary.title(sweep), line,
        summary.tables(sweep), more,
    )  # fmt: skip


def write_comparison(
    path: Path,
    names: tuple[str, str],
    tables: tuple[FlightTable, FlightTable],
    found: SweepComparison,
) -> Path:
    """Write the page of B beside A; `names` and `tables` are theirs."""
    pictures = []
    with TemporaryDirectory() as folder:
        for number, (label, column) in enumerate(comparison.ERRORS):
            file = save(paired(label, column, *tables), Path(folder) / f"{number}.png")
            pictures.append(_picture(f"{label}, each draw in A and in B", file))
    return _write(
        path,
        "compare",
        " and ".join(names),
        f"A is {names[0]}, B is {names[1]}. Draws are paired.",
        comparison.line(found).plain,
        comparison.tables(found),
        "\n".join(pictures),
    )
