"""The files of a run: results.md, results.json, timing.json, and docs/results.md when asked."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table as RichTable

from ptnsbc_tools.reproduce.document import Origin, document
from ptnsbc_tools.reproduce.experiment_result import ExperimentResult, ReproduceError, rounded
from ptnsbc_tools.reproduce.folder import RESULTS
from ptnsbc_tools.reproduce.runner import TimedResult

_IMAGES = "img/results"


def _untimed(made: Sequence[TimedResult]) -> list[dict[str, Any]]:
    """The parts as they are the same every time; of a timed one only that it was run."""
    return [
        {"name": one.part.name, "timed": True} if one.part.timed else one.part.as_json()
        for one in made
    ]


def summary(made: Sequence[TimedResult]) -> dict[str, Any]:
    """Claims and run time, for `--json`."""
    claims = [rounded(vars(claim)) for one in made for claim in one.part.claims]
    return {"claims": claims, "seconds": {one.part.name: round(one.seconds, 1) for one in made}}


def write(origin: Origin, made: Sequence[TimedResult], place: Path) -> None:
    """Write results.md, results.json and timing.json into the folder of a run."""
    parts = [one.part for one in made]
    text = document(origin, parts, images="figures", all_figures=True)
    (place / "results.md").write_text(text, encoding="utf-8")
    results = {"origin": vars(origin), "parts": _untimed(made)}
    _write_json(place / RESULTS, results)
    timed = [one.part.as_json() for one in made if one.part.timed]
    _write_json(place / "timing.json", {"seconds": summary(made)["seconds"], "parts": timed})


def _write_json(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def write_docs(origin: Origin, made: Sequence[TimedResult], place: Path, docs: Path) -> None:
    """Write results.md with the few telling figures into a folder of documents."""
    parts = [one.part for one in made]
    try:
        images = docs / _IMAGES
        images.mkdir(parents=True, exist_ok=True)
        for old in images.glob("*.png"):
            old.unlink()
        for figure in _telling(parts):
            shutil.copyfile(place / "figures" / f"{figure}.png", images / f"{figure}.png")
        path = docs / "results.md"
        part = path.with_name(".results.md.part")
        part.write_text(document(origin, parts, images=_IMAGES, all_figures=False), "utf-8")
        part.replace(path)
    except OSError as error:
        raise ReproduceError(f"--docs {docs}: {error.strerror}: expected to write there") from None


def _telling(parts: Sequence[ExperimentResult]) -> list[str]:
    return [figure.name for part in parts for figure in part.figures if figure.telling]


def claims_table(made: Sequence[TimedResult]) -> RichTable:
    """The verdicts for a terminal."""
    table = RichTable(title="Claims of the paper", title_justify="left")
    for name in ("claim", "its number", "verdict", "where"):
        table.add_column(name, overflow="fold")
    for one in made:
        for claim in one.part.claims:
            table.add_row(claim.said, claim.number, claim.verdict, claim.figures)
    return table
