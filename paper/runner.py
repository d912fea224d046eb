"""Experiments in processes of their own, as many at a time as there are jobs, and their progress on stderr."""

from __future__ import annotations

import multiprocessing
import queue
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from paper import flights
from paper.catalogue import Experiment
from paper.experiment_result import ExperimentResult, ReproduceError
from paper.figures import style
from paper.flights import Setting
from paper.output import ExperimentFolder
from ptnsbc_nodes.runtime.signals import StopRequest
from ptnsbc_sim.sweep.runner import depend_on_parent
from ptnsbc_tools import console

_POLL_S = 0.1


class ExperimentProgress(NamedTuple):
    """The progress of an experiment now; `done` when it has ended."""

    experiment: str
    line: str
    done: bool = False


@dataclass(frozen=True)
class TimedResult:
    """The result of an experiment, and how long it took."""

    part: ExperimentResult
    seconds: float


_progress_queue: Any = None  # in a worker: the queue to the parent


def _start_worker(progress_queue: Any, settings: Setting) -> None:
    global _progress_queue
    _progress_queue = progress_queue
    flights.use(settings)
    depend_on_parent()


def _run_in_worker(experiment: Experiment, folder: Path) -> TimedResult:
    def report(line: str) -> None:
        _progress_queue.put(ExperimentProgress(experiment.name, line))

    return run_one(experiment, ExperimentFolder(folder, report))


def run_one(experiment: Experiment, output: ExperimentFolder) -> TimedResult:
    """Run one experiment in this process."""
    started = time.monotonic()
    with style.applied():
        part = experiment.load()(output)
    return TimedResult(part, time.monotonic() - started)


@contextmanager
def _worker_pool(jobs: int, settings: Setting) -> Iterator[tuple[ProcessPoolExecutor, Any]]:
    """Worker processes; an error in the block terminates them at once."""
    # Not forked: a copy of a process with threads may hang.
    context = multiprocessing.get_context("spawn")
    progress_queue = context.Queue()
    pool = ProcessPoolExecutor(jobs, context, _start_worker, (progress_queue, settings))
    try:
        yield pool, progress_queue
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    finally:
        pool.shutdown()


def run_all(
    experiments: Sequence[Experiment],
    folder: Path,
    jobs: int,
    on_progress: Callable[[ExperimentProgress], None],
    settings: Setting | None = None,
) -> list[TimedResult]:
    """Run experiments into a folder; the results are in the order given.

    Experiments that measure time come last, one by one. `settings` change the scenarios of all experiments.

    Raises:
        KeyboardInterrupt: SIGINT or SIGTERM came.
        ReproduceError: a worker died.
    """
    done: dict[str, TimedResult] = {}
    with StopRequest() as stop, _worker_pool(jobs, settings or {}) as (pool, progress_queue):
        together = sorted((one for one in experiments if not one.alone), key=lambda x: -x.seconds)
        for batch in [together, *([one] for one in experiments if one.alone)]:
            futures = {pool.submit(_run_in_worker, one, folder): one.name for one in batch}
            for future in _as_completed(futures, progress_queue, stop, on_progress):
                name = futures[future]
                done[name] = _result(future, name)
                line = f"done in {done[name].seconds:.0f} s"
                on_progress(ExperimentProgress(name, line, done=True))
    return [done[one.name] for one in experiments]


def _result(future: Future[TimedResult], name: str) -> TimedResult:
    try:
        return future.result()
    except BrokenExecutor:
        raise ReproduceError(
            f"{name}: a process of this run was killed: expected memory for each of --jobs, try fewer"
        ) from None
    except OSError as error:
        raise ReproduceError(f"{name}: {error}: expected to write its results") from None


def _as_completed(
    futures: Iterable[Future[TimedResult]],
    progress_queue: Any,
    stop: StopRequest,
    on_progress: Callable[[ExperimentProgress], None],
) -> Iterator[Future[TimedResult]]:
    """Futures as they complete; progress is passed on meanwhile."""
    waiting = list(futures)  # in order, also for those that end at the same moment
    while waiting:
        if stop.came:
            raise KeyboardInterrupt
        with suppress(queue.Empty):
            on_progress(progress_queue.get(timeout=_POLL_S))
        for future in [one for one in waiting if one.done()]:
            waiting.remove(future)
            yield future


@contextmanager
def progress_shown(
    experiments: Sequence[Experiment],
) -> Iterator[Callable[[ExperimentProgress], None]]:
    """Progress on stderr: a bar on a terminal, otherwise one line for each experiment that has ended."""
    seconds = {one.name: one.seconds for one in experiments}
    if not sys.stderr.isatty():
        ended: list[str] = []

        def print_line(progress: ExperimentProgress) -> None:
            if progress.done:
                ended.append(progress.experiment)
                count = f"({len(ended)} of {len(seconds)})"
                print(
                    f"{progress.experiment}: {progress.line} {count}", file=sys.stderr, flush=True
                )

        yield print_line
        return
    columns = (BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console.err(), transient=True) as bar:
        task = bar.add_task("starting", total=sum(seconds.values()))

        def move_bar(progress: ExperimentProgress) -> None:
            advance = seconds[progress.experiment] if progress.done else 0.0
            bar.update(task, advance=advance, description=f"{progress.experiment}: {progress.line}")

        yield move_bar
