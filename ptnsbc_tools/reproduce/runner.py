"""Experiments in processes of their own, as many at a time as there are jobs."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from ptnsbc_nodes.runtime.signals import StopRequest
from ptnsbc_tools.reproduce import flights
from ptnsbc_tools.reproduce.catalogue import Experiment
from ptnsbc_tools.reproduce.experiment_folder import ExperimentFolder
from ptnsbc_tools.reproduce.experiment_result import ExperimentResult, ReproduceError
from ptnsbc_tools.reproduce.figures import style
from ptnsbc_tools.reproduce.flights import Setting

_LOOK_S = 0.1


class ExperimentProgress(NamedTuple):
    """What an experiment is doing now; `done` when it has ended."""

    experiment: str
    line: str
    done: bool = False


@dataclass(frozen=True)
class TimedResult:
    """A part, and how long it took."""

    part: ExperimentResult
    seconds: float


_told: Any = None  # in a worker: the queue to the parent


def _begin(told: Any, settings: Setting) -> None:
    """In a worker, once: Ctrl-C is the parent's to answer, and without a parent there is no work."""
    global _told
    _told = told
    flights.use(settings)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent,), daemon=True).start()


def _follow(parent: Any) -> None:
    parent.join()
    os._exit(1)


def _work(experiment: Experiment, folder: Path) -> TimedResult:
    """In a worker: one experiment."""

    def tell(line: str) -> None:
        if _told is not None:
            _told.put(ExperimentProgress(experiment.name, line))

    return work(experiment, ExperimentFolder(folder, tell))


def work(experiment: Experiment, workshop: ExperimentFolder) -> TimedResult:
    """Run one experiment in this process."""
    started = time.monotonic()
    with style.applied():
        part = experiment.load()(workshop)
    return TimedResult(part, time.monotonic() - started)


@contextmanager
def _pool(jobs: int, settings: Setting) -> Iterator[tuple[ProcessPoolExecutor, Any]]:
    """Worker processes that end with the block, whatever they are at."""
    # Not forked: a copy of a process with threads may hang.
    context = multiprocessing.get_context("spawn")
    told = context.Queue()
    pool = ProcessPoolExecutor(jobs, context, _begin, (told, settings))
    try:
        yield pool, told
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
    tell: Callable[[ExperimentProgress], None],
    settings: Setting | None = None,
) -> list[TimedResult]:
    """Run experiments into a folder; the results in the order given.

    Those that measure time come last, one by one. `settings` change the scenarios of all of them.

    Raises:
        KeyboardInterrupt: SIGINT or SIGTERM came.
        ReproduceError: a worker died.
    """
    done: dict[str, TimedResult] = {}
    with StopRequest() as stop, _pool(jobs, settings or {}) as (pool, told):
        together = sorted((one for one in experiments if not one.alone), key=lambda x: -x.seconds)
        rounds = [together, *([one] for one in experiments if one.alone)]
        for some in rounds:
            futures = {pool.submit(_work, one, folder): one.name for one in some}
            for future in _finished(futures, told, stop, tell):
                name = futures[future]
                done[name] = _result(future, name)
                tell(ExperimentProgress(name, f"done in {done[name].seconds:.0f} s", done=True))
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


def _finished(
    futures: Iterable[Future[TimedResult]],
    told: Any,
    stop: StopRequest,
    tell: Callable[[ExperimentProgress], None],
) -> Iterator[Future[TimedResult]]:
    """Futures as they complete, passing on the news meanwhile."""
    waiting = list(futures)  # in order: those that end in the same moment too
    while waiting:
        if stop.came:
            raise KeyboardInterrupt
        with suppress(queue.Empty):
            tell(told.get(timeout=_LOOK_S))
        for future in [one for one in waiting if one.done()]:
            waiting.remove(future)
            yield future
