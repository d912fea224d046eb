"""Progress of a whole run: a bar on a terminal, a line per experiment elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ptnsbc_tools import console
from ptnsbc_tools.reproduce.catalogue import Experiment
from ptnsbc_tools.reproduce.runner import ExperimentProgress


@contextmanager
def shown(experiments: Sequence[Experiment]) -> Iterator[Callable[[ExperimentProgress], None]]:
    """What the runner tells, on stderr."""
    weights = {one.name: one.seconds for one in experiments}
    if not sys.stderr.isatty():
        yield _Lines(len(weights))
        return
    columns = (BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console.err(), transient=True) as bar:
        task = bar.add_task("starting", total=sum(weights.values()))

        def tell(news: ExperimentProgress) -> None:
            advance = weights[news.experiment] if news.done else 0.0
            bar.update(task, advance=advance, description=f"{news.experiment}: {news.line}")

        yield tell


class _Lines:
    """One line per experiment that has ended."""

    def __init__(self, total: int) -> None:
        self._done, self._total = 0, total

    def __call__(self, news: ExperimentProgress) -> None:
        if not news.done:
            return
        self._done += 1
        line = f"{news.experiment}: {news.line} ({self._done} of {self._total})"
        print(line, file=sys.stderr, flush=True)
