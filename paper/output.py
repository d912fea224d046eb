"""The folder of results: complete or absent, and what one experiment writes into it."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from paper.experiment_result import Figure, ReproduceError
from paper.figures import style
from ptnsbc_core.types import Array

RESULTS = "results.json"

Curves = Mapping[str, Array]
"""Columns (T,) of one CSV file by name; each name ends in its unit."""


def check_free(folder: Path, names: Sequence[str]) -> None:
    """Raise an error when `folder` holds something that this run would destroy.

    Args:
        folder: where results are to go.
        names: the experiments of this run.
    """
    if folder.exists() and not folder.is_dir():
        raise ReproduceError(f"-o {folder}: is a file: expected a folder, or a name not in use")
    if not folder.exists() or not any(folder.iterdir()):
        return
    try:
        results = json.loads((folder / RESULTS).read_text(encoding="utf-8"))
        existing = [str(part["name"]) for part in results["parts"]]
    except (OSError, ValueError, KeyError, TypeError):
        raise ReproduceError(
            f"-o {folder}: holds other things than results: expected an empty or new folder, or "
            "one that an earlier run has made"
        ) from None
    lost = [name for name in existing if name not in names]
    if lost:
        raise ReproduceError(
            f"-o {folder}: holds results of {', '.join(lost)}, which this run would not replace: "
            "choose another folder, or leave out --only"
        )


@contextmanager
def temporary_folder(folder: Path) -> Iterator[Path]:
    """A folder to work in. It replaces `folder` when the block ends without an error, and is deleted otherwise."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise ReproduceError(f"-o {folder}: {error.strerror}: expected a place to write") from None
    try:
        mask = os.umask(0)
        os.umask(mask)
        made.chmod(0o777 & ~mask)  # mkdtemp gives access to its owner alone
        yield made
        if folder.exists():  # the old results are deleted last
            old = made.with_name(f"{made.name}.old")
            folder.replace(old)
            made.replace(folder)
            shutil.rmtree(old, ignore_errors=True)
        else:
            made.replace(folder)
    finally:
        shutil.rmtree(made, ignore_errors=True)


@dataclass(frozen=True)
class ExperimentFolder:
    """The folder of one run, and the function that reports progress."""

    folder: Path
    progress: Callable[[str], None]

    def write_curves(self, name: str, columns: Curves) -> None:
        """Write the curves of a figure as CSV; a short column ends with empty cells."""
        folder = self.folder / "curves"
        folder.mkdir(parents=True, exist_ok=True)
        longest = max(len(column) for column in columns.values())
        cells = [
            [f"{value:.6g}" for value in column.tolist()] + [""] * (longest - len(column))
            for column in columns.values()
        ]
        heads = [re.sub(r"\W+", "_", name) for name in columns]  # a comma would add a column
        lines = [",".join(heads), *(",".join(row) for row in zip(*cells, strict=True))]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")

    def write_figure(self, figure: Figure, drawing: Any, columns: Curves) -> Figure:
        """Write a drawing and the curves in it under the name of `figure`; returns `figure`."""
        style.save(drawing, self.folder / "figures", figure.name)
        self.write_curves(figure.name, columns)
        return figure


def time_column(times: Array) -> dict[str, Array]:
    """The first column of a CSV file, without the rounding error of 1e-9 times a tick."""
    return {"time_s": np.round(times, 6)}
