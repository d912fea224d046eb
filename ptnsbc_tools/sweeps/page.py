"""The page of a sweep: one HTML file that works offline, with its figures as PNG beside it."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path
from string import Template

from ptnsbc_tools.files import replacing
from ptnsbc_tools.plotting.draw import save
from ptnsbc_tools.report.page import asset, html_table
from ptnsbc_tools.sweeps import summary
from ptnsbc_tools.sweeps.figures import figures
from ptnsbc_tools.sweeps.table import FlownSweep

FOLDER = "report"

_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="ptnsbc sweep">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>$name – sweep</title>
<style>
$style
figure { margin: 0 0 16px; } figure img { max-width: 100%; background: white; border-radius: 12px; }
figcaption { color: var(--soft); font-size: 13px; }
</style>
</head>
<body>
<header class="top"><div><p class="kicker">Sweep</p><h1>$name</h1></div></header>
<main>
<p>$heading</p>
<p><b>$line</b></p>
$tables
<p>These commands fly them again:</p>
<pre>$commands</pre>
$figures
<details><summary>Plan</summary><pre>$plan</pre></details>
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


def write_report(sweep: FlownSweep) -> Path:
    """Write the page and the figures into `report/` of the sweep's folder; returns the page."""
    folder = sweep.folder / FOLDER
    pictures = [
        _picture(one.caption, save(one.figure, folder / f"{one.name}.png"))
        for one in figures(sweep)
    ]
    commands = "\n".join(one.command for one in summary.worst(sweep))
    text = _PAGE.substitute(
        name=escape(sweep.plan.name),
        heading=escape(summary.title(sweep)),
        style=asset("style.css"),
        line=escape(summary.line(sweep).plain),
        tables="\n".join(html_table(table) for table in summary.tables(sweep)),
        commands=escape(commands),
        figures="\n".join(pictures),
        plan=escape(sweep.plan.to_json()),
    )
    path = folder / "index.html"
    with replacing(path) as part:
        folder.mkdir(parents=True, exist_ok=True)
        part.write_text(text, encoding="utf-8")
    return path
