"""Flying a sweep: chunks over processes here or over a dask cluster, each written as it is done.

A folder holds `plan.json`, `chunks/00000.parquet` … and at the end `table.parquet`. A sweep that was ended
early is continued from its chunks. The table does not depend on who flew which chunk.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.files import replacing
from ptnsbc_sim.sweep.chunks import (
    chunk_count,
    chunk_draws,
    fly_chunk,
    join_chunks,
    made_by,
    made_by_others,
    schema,
)
from ptnsbc_sim.sweep.draws import SweepError
from ptnsbc_sim.sweep.plan import SweepPlan
from ptnsbc_sim.sweep.rows import fly_draw

PLAN, CHUNKS, TABLE = "plan.json", "chunks", "table.parquet"

_MOST_ERRORS = 2  # a chunk that fails is tried once more
_MOST_DEATHS = 3  # workers that a chunk may take with it

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class FailedChunk:
    """A chunk that could not be flown, twice."""

    index: int
    draws: range
    error: str


@dataclass(frozen=True)
class SweepResult:
    """A sweep that has been flown."""

    plan: SweepPlan
    folder: Path
    failed: tuple[FailedChunk, ...]  # their draws are missing in the table

    @property
    def table(self) -> Path:
        """The Parquet file with one row for each UAV and flight."""
        return self.folder / TABLE


@dataclass(frozen=True)
class _Outcome:
    """One attempt at a chunk: its bytes, or what went wrong."""

    index: int
    data: bytes = b""
    error: str = ""
    died: bool = False  # its worker ended


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


def run(
    plan: SweepPlan,
    folder: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> SweepResult:
    """Fly a sweep, or what is missing of it.

    Args:
        plan: what to fly.
        folder: where the chunks and the table are written; of the same plan when it exists.
        workers: processes on this machine, by default one for each core.
        scheduler: address of a dask scheduler whose workers fly instead.
        progress: called with (flights done, flights in all).

    Returns:
        The table's place, and the chunks that failed.

    Raises:
        SweepError: the folder holds another plan, or flights of other laws.
        KeyboardInterrupt: ended early; chunks that are done stay, and the next run continues.
    """
    _prepare(plan, folder)
    missing = [index for index in range(chunk_count(plan)) if not _chunk(folder, index).exists()]
    done = plan.draws - sum(len(chunk_draws(plan, index)) for index in missing)
    if progress is not None:
        progress(done, plan.draws)
    failed = []
    attempts = _with_dask if scheduler is not None else _with_processes
    queue = _Queue(plan, missing)
    for outcome in attempts(queue, scheduler or "", workers or cores()):
        failure = queue.settle(outcome)
        if failure is not None:
            failed.append(failure)
        if outcome.data:
            with replacing(_chunk(folder, outcome.index)) as part:
                part.write_bytes(outcome.data)
            done += len(chunk_draws(plan, outcome.index))
            if progress is not None:
                progress(done, plan.draws)
    here = (_chunk(folder, index) for index in range(chunk_count(plan)))
    with replacing(folder / TABLE) as part:
        part.write_bytes(join_chunks(plan, (p.read_bytes() for p in here if p.exists())))
    return SweepResult(plan, folder, tuple(sorted(failed, key=lambda one: one.index)))


def _chunk(folder: Path, index: int) -> Path:
    return folder / CHUNKS / f"{index:05d}.parquet"


def _prepare(plan: SweepPlan, folder: Path) -> None:
    path, text = folder / PLAN, plan.to_json()
    if path.exists():
        if path.read_text(encoding="utf-8") != text:
            raise SweepError(
                f"{folder}: holds a sweep of another plan: expected an empty folder, or the same plan"
            )
        if flown_by_others(folder, plan):
            raise SweepError(
                f"{folder}: holds flights of other laws or library versions, which do not belong into one "
                "table with those of today: expected an empty folder"
            )
    elif folder.exists() and any(folder.iterdir()):
        raise SweepError(f"{folder}: holds other files: expected an empty folder, or a sweep")
    (folder / CHUNKS).mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_bytes(text.encode())


def flown_by_others(folder: Path, plan: SweepPlan) -> bool:
    """True if a folder holds flights of other laws, the user's too, or library versions."""
    today = made_by(plan)
    return any(made_by_others(chunk, today) for chunk in (folder / CHUNKS).glob("*.parquet"))


class _Queue:
    """The chunks that are still to be flown, and how often each has failed."""

    def __init__(self, plan: SweepPlan, missing: Iterable[int]) -> None:
        self.text = plan.to_json()
        self._plan = plan
        self._waiting = deque(missing)
        self._errors: Counter[int] = Counter()
        self._deaths: Counter[int] = Counter()

    def __len__(self) -> int:
        return len(self._waiting)

    def take(self) -> int:
        """The next chunk."""
        return self._waiting.popleft()

    def settle(self, outcome: _Outcome) -> FailedChunk | None:
        """Have a chunk that failed tried again; the failure when it is given up."""
        if not outcome.error:
            return None
        index = outcome.index
        (self._deaths if outcome.died else self._errors)[index] += 1
        if self._errors[index] < _MOST_ERRORS and self._deaths[index] < _MOST_DEATHS:
            self._waiting.append(index)
            return None
        return FailedChunk(index, chunk_draws(self._plan, index), outcome.error)


def _outcome(index: int, work: Callable[[], bytes]) -> _Outcome:
    try:
        return _Outcome(index, data=work())
    except BrokenProcessPool:
        return _Outcome(index, error="its worker process ended", died=True)
    except PtnsbcError as error:
        return _Outcome(index, error=str(error))
    except Exception as error:  # of a flight: the other chunks go on
        return _Outcome(index, error=f"{type(error).__name__}: {error}")


def _with_processes(queue: _Queue, _: str, workers: int) -> Iterator[_Outcome]:
    """Attempts by processes of this machine; by this process when there is one worker."""
    if not len(queue):
        return
    if workers == 1:
        while len(queue):
            index = queue.take()
            yield _outcome(index, lambda index=index: fly_chunk(queue.text, index))  # type: ignore[misc]
        return
    _warm_up(queue.text)
    while len(queue):  # again when a worker has ended, which ends its pool
        yield from _pool(queue, workers)


def _warm_up(plan_json: str) -> None:
    """Load what a chunk needs before the workers are forked: they have it at once."""
    import pyarrow.parquet  # noqa: F401

    plan = SweepPlan.from_json(plan_json)
    schema(plan)
    fly_draw(plan, 0)  # in full: the kernels that judge an encounter are among them


def _pool(queue: _Queue, workers: int) -> Iterator[_Outcome]:
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=depend_on_parent) as pool:
        running: dict[Future[bytes], int] = {}
        try:
            while len(queue) or running:
                while len(queue) and len(running) < 2 * workers:
                    index = queue.take()
                    with warnings.catch_warnings():  # of threads: those of BLAS, idle
                        warnings.simplefilter("ignore", DeprecationWarning)
                        running[pool.submit(fly_chunk, queue.text, index)] = index
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    outcome = _outcome(running.pop(future), future.result)
                    yield outcome
                    if outcome.died:
                        for other, index in running.items():
                            yield _outcome(index, other.result)
                        return
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def depend_on_parent() -> None:
    """Prepare a worker process: Ctrl-C is the business of the parent, and the worker ends when that has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)


def _with_dask(queue: _Queue, address: str, _: int) -> Iterator[_Outcome]:
    """Attempts by the workers of a dask cluster; a worker that ends loses the chunk that it flies."""
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise SweepError('scheduler: dask is not installed: pip install "ptnsbc[sweep]"') from None
    from distributed.scheduler import KilledWorker

    with Client(address) as client:
        ready = as_completed()
        numbers: dict[Any, int] = {}

        def submit() -> None:
            while len(queue):
                index = queue.take()
                future = client.submit(fly_chunk, queue.text, index, pure=False)
                numbers[future.key] = index
                ready.add(future)

        submit()
        for future in ready:
            index = numbers.pop(future.key)
            try:
                outcome = _outcome(index, future.result)
            except KilledWorker:
                outcome = _Outcome(index, error="its worker ended", died=True)
            yield outcome
            future.release()
            submit()
