"""Where an experiment works: it writes its figures and curves here and tells what it is doing."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_tools.reproduce.figures import style

Curves = Mapping[str, Array]
"""Columns (T,) of one sheet by name; the names end in their unit."""


@dataclass(frozen=True)
class ExperimentFolder:
    """The folder of one run, and who is told about progress."""

    folder: Path
    tell: Callable[[str], None]

    def curves(self, name: str, columns: Curves) -> None:
        """Write what a figure shows as CSV; columns of different length leave cells empty."""
        folder = self.folder / "curves"
        folder.mkdir(parents=True, exist_ok=True)
        longest = max(len(column) for column in columns.values())
        texts = [
            [f"{value:.6g}" for value in column.tolist()] + [""] * (longest - len(column))
            for column in columns.values()
        ]
        heads = [
            re.sub(r"\W+", "_", column) for column in columns
        ]  # a comma would be a column more
        lines = [",".join(heads), *(",".join(row) for row in zip(*texts, strict=True))]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")

    def figure(self, name: str, made: Any, columns: Curves) -> None:
        """Write a figure and the curves that are in it."""
        style.save(made, self.folder / "figures", name)
        self.curves(name, columns)


def times_column(times: Array) -> Array:
    """Times as they are written: a clock of 10 ms, without the noise of 1e-9 times a tick."""
    return np.round(times, 6)
