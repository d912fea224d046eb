"""Flying a sweep: chunks over processes, each written as it is done.

A folder holds `plan.json`, `chunks/00000.parquet` … and at the end `table.parquet`. A sweep that was ended
early is continued from its chunks. The table does not depend on who flew which chunk.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import re
import signal
import threading
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import lru_cache, partial
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from arro3.core import Array, DataType, Field, Schema, Table
from arro3.io import read_parquet, write_parquet

from ptnsbc_core.compile_cache import source_digest
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.files import replacing
from ptnsbc_sim.scenario.fields import unit_of
from ptnsbc_sim.swarm import HeadlessFlight
from ptnsbc_sim.sweep.draws import SweepError
from ptnsbc_sim.sweep.dry_run import dry_run_says
from ptnsbc_sim.sweep.plan import SweepPlan, Value, axis_values, drawn_values
from ptnsbc_sim.sweep.rows import UNITS, SweepRow, fly_draw, not_flown

CHUNK_DRAWS = 25
"""Draws of a chunk. A part of the format: a sweep is continued by its chunks, whoever flew them."""

DRAWN = "drawn."
"""Prefix of the columns that hold what was drawn."""

_FILE = re.compile(r"(/[^\n'\"]+?\.py):[A-Za-z_]")  # of a function of the user


def chunk_count(plan: SweepPlan) -> int:
    """The number of chunks of a sweep."""
    return -(-plan.draws // CHUNK_DRAWS)


def chunk_draws(plan: SweepPlan, index: int) -> range:
    """The draws of a chunk."""
    return range(index * CHUNK_DRAWS, min((index + 1) * CHUNK_DRAWS, plan.draws))


def fly_chunk(plan_json: str, index: int) -> bytes:
    """Fly all draws of a chunk, one after the other in the same memory; returns a Parquet file with their rows.

    A draw that cannot be flown has one row with the cause.
    """
    plan = SweepPlan.from_json(plan_json)
    rows: list[SweepRow] = []
    drawn: list[Mapping[str, Value]] = []
    room: HeadlessFlight | None = None
    for k in chunk_draws(plan, index):
        try:
            check = dry_run_says(plan, k) if plan.check else ""
            found, values, room = fly_draw(plan, k, room, check)
        except PtnsbcError as error:
            found, values = [not_flown(k, str(error))], axis_values(plan, k)
        rows += found
        drawn += [values] * len(found)
    return _parquet(_table(plan, rows, drawn))


class ColumnKind(NamedTuple):
    """A column of the table of a sweep."""

    name: str
    kind: str  # int, float, str or bool
    unit: str  # empty for words and numbers without one


@lru_cache(maxsize=2)
def columns_of(plan: SweepPlan) -> tuple[ColumnKind, ...]:
    """The columns of the table: what is drawn, then the figures of a UAV."""
    first = drawn_values(plan, 0) if plan.family else {}
    drawn = {key: "float" if of is None else type(of).__name__ for key, of in first.items()}
    for axis in plan.axes:
        kinds = {type(value) for value in axis.values}
        if axis.random or (kinds <= {int, float} and kinds != {int}):
            drawn[axis.key] = "float"
        else:
            drawn[axis.key] = kinds.pop().__name__ if kinds in ({int}, {bool}) else "str"
    units = {key: unit_of(key.rpartition(".")[2]) or "" for key in drawn}
    return (
        *(ColumnKind(f"{DRAWN}{key}", kind, units[key]) for key, kind in drawn.items()),
        *(
            ColumnKind(field.name, str(field.type).partition(" ")[0], UNITS[field.name])
            for field in fields(SweepRow)
        ),
    )


@lru_cache(maxsize=2)
def schema(plan: SweepPlan) -> Schema:
    """Columns of the table, units in the metadata of each, plan and versions in that of the file."""
    types = {
        "int": DataType.int64(),
        "float": DataType.float64(),
        "str": DataType.string(),
        "bool": DataType.bool(),
    }
    columns = [
        Field(name, types[kind], metadata={"unit": unit} if unit else {})
        for name, kind, unit in columns_of(plan)
    ]
    return Schema(
        columns, metadata={"ptnsbc.plan": plan.to_json(), "ptnsbc.made_by": made_by(plan)}
    )


def read_table(data: bytes) -> Table:
    """The table in a Parquet file; ValueError when the file is damaged."""
    if len(data) < 12 or not data[:4] == data[-4:] == b"PAR1":
        raise ValueError("the file is cut short")
    try:
        return read_parquet(BytesIO(data)).read_all()
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # the panic of arro3 at a damaged footer is no Exception
        raise ValueError(str(error)) from None


def made_by_others(chunk: Path, today: str) -> bool:
    """True if the flights in the file of a chunk were flown by other laws or library versions than `made_by` says."""
    try:
        metadata = read_table(chunk.read_bytes()).schema.metadata_str
    except (OSError, ValueError):  # a damaged file is nobody's
        return True
    return metadata.get("ptnsbc.made_by") != today


def made_by(plan: SweepPlan) -> str:
    """All that decides the figures besides the plan, as JSON; the same sweep gives the same bytes."""
    made = {}
    for package in ("ptnsbc", "numpy", "numba"):
        with suppress(PackageNotFoundError):
            made[package] = version(package)
    made["kernels"] = source_digest()
    texts = [plan.scenario, *(str(value) for axis in plan.axes for value in axis.values)]
    for name in sorted({name for text in texts for name in _FILE.findall(text)}):
        try:
            made[f"file {name}"] = hashlib.sha256(Path(name).read_bytes()).hexdigest()
        except OSError:  # the first flight says so
            made[f"file {name}"] = ""
    return json.dumps(made)


def _table(
    plan: SweepPlan, rows: Sequence[SweepRow], drawn: Sequence[Mapping[str, Value]]
) -> Table:
    cells = {"int": int, "float": float, "bool": bool, "str": str}
    arrays = []
    for name, kind, _ in columns_of(plan):
        if name.startswith(DRAWN):
            given = [of.get(name.removeprefix(DRAWN)) for of in drawn]
            values = [None if value is None else cells[kind](value) for value in given]
        else:
            values = [getattr(row, name) for row in rows]
        arrays.append(Array(values, schema(plan).field(name).type))
    return Table.from_arrays(arrays, schema=schema(plan))


def _parquet(table: Table) -> bytes:
    out = BytesIO()
    write_parquet(table, out, compression="zstd(1)")
    return out.getvalue()


def join_chunks(plan: SweepPlan, chunks: Iterable[bytes]) -> bytes:
    """The table of a sweep from its chunks, in their order."""
    batches = [batch for chunk in chunks for batch in read_table(chunk).to_batches()]
    return _parquet(Table.from_batches(batches, schema=schema(plan)))


PLAN, CHUNKS, TABLE, SEARCH = "plan.json", "chunks", "table.parquet", "search"

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


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


def run(
    plan: SweepPlan, folder: Path, *, workers: int | None = None, progress: Progress | None = None
) -> SweepResult:
    """Fly a sweep, or what is missing of it.

    Args:
        plan: what to fly.
        folder: of the chunks and the table; with those of the same plan when it exists.
        workers: processes on this machine, by default one for each core.
        progress: called with (flights done, flights in all).

    Raises:
        SweepError: the folder holds another plan, or flights of other laws.
        KeyboardInterrupt: ended early; chunks that are done stay, and the next run continues.
    """
    path, other = folder / PLAN, held(folder, plan)
    if not path.exists() and folder.exists() and {one.name for one in folder.iterdir()} - {SEARCH}:
        other = "other files"
    if other:
        raise SweepError(f"{folder}: holds {other}: expected an empty folder, or the same sweep")
    (folder / CHUNKS).mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_bytes(plan.to_json().encode())
    chunks = [folder / CHUNKS / f"{index:05d}.parquet" for index in range(chunk_count(plan))]
    missing = [index for index, chunk in enumerate(chunks) if not chunk.exists()]
    done = plan.draws - sum(len(chunk_draws(plan, index)) for index in missing)
    if progress is not None:
        progress(done, plan.draws)

    def keep(index: int, data: bytes) -> None:
        nonlocal done
        with replacing(chunks[index]) as part:
            part.write_bytes(data)
        done += len(chunk_draws(plan, index))
        if progress is not None:
            progress(done, plan.draws)

    queue = _Queue(plan, missing, keep)
    _fly(queue, workers or cores())
    with replacing(folder / TABLE) as part:
        part.write_bytes(join_chunks(plan, (p.read_bytes() for p in chunks if p.exists())))
    failed = (
        FailedChunk(index, chunk_draws(plan, index), error)
        for index, error in sorted(queue.given_up.items())
    )
    return SweepResult(plan, folder, tuple(failed))


def held(folder: Path, plan: SweepPlan) -> str:
    """The reason why the sweep in a folder cannot go on with this plan; empty when it can, or there is none."""
    path, today = folder / PLAN, made_by(plan)
    if not path.is_file():
        return ""
    if path.read_text(encoding="utf-8") != plan.to_json():
        return "a sweep of another plan"
    chunks = (folder / CHUNKS).glob("*.parquet")
    if any(made_by_others(chunk, today) for chunk in chunks):
        return "flights of other laws or library versions"
    return ""


class _Queue:
    """The chunks that are still to be flown. One that fails is tried again."""

    def __init__(
        self, plan: SweepPlan, missing: Iterable[int], keep: Callable[[int, bytes], None]
    ) -> None:
        """`keep` takes the bytes of each chunk."""
        self.plan, self.text = plan, plan.to_json()
        self.waiting = deque(missing)
        self.given_up: dict[int, str] = {}  # the error of each chunk
        self._keep = keep
        self._failures: Counter[tuple[int, bool]] = Counter()

    def settle(self, index: int, fly: Callable[[], bytes]) -> bool:
        """Keep what `fly` gives; True if the worker of the chunk has died."""
        died = False
        try:
            data = fly()
        except BrokenProcessPool:
            error, died = "its worker process ended", True
        except PtnsbcError as refused:
            error = str(refused)
        except Exception as broken:  # of a flight: the other chunks go on
            error = f"{type(broken).__name__}: {broken}"
        else:
            self._keep(index, data)
            return False
        self._failures[index, died] += 1
        if self._failures[index, died] < (_MOST_DEATHS if died else _MOST_ERRORS):
            self.waiting.append(index)
        else:
            self.given_up[index] = error
        return died


def _fly(queue: _Queue, workers: int) -> None:
    """Fly all chunks: by this process when it is the one worker, or by processes."""
    if workers == 1:
        while queue.waiting:
            index = queue.waiting.popleft()
            queue.settle(index, partial(fly_chunk, queue.text, index))
    elif queue.waiting:
        # The laws are loaded before the workers are forked: each worker has them at once.
        fly_draw(queue.plan, 0)  # in full: the kernels that judge an encounter are among them
        context = multiprocessing.get_context("fork")
        while queue.waiting:
            pool = ProcessPoolExecutor(workers, mp_context=context, initializer=depend_on_parent)
            try:
                _execute(queue, pool, 2 * workers)
            finally:
                pool.shutdown(wait=True, cancel_futures=True)


def _execute(queue: _Queue, pool: ProcessPoolExecutor, most: int) -> None:
    """Fly chunks by the workers of a pool, `most` at a time, until one ends, which ends the pool."""
    running: dict[Future[bytes], int] = {}
    while queue.waiting or running:
        while queue.waiting and len(running) < most:
            index = queue.waiting.popleft()
            with warnings.catch_warnings():  # of threads: those of BLAS, idle
                warnings.simplefilter("ignore", DeprecationWarning)
                running[pool.submit(fly_chunk, queue.text, index)] = index
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            if queue.settle(running.pop(future), future.result):
                for other, index in running.items():
                    queue.settle(index, other.result)
                return


def depend_on_parent() -> None:
    """Prepare a worker process: Ctrl-C is the business of the parent, and the worker ends when that has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:

        def end_with_parent() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=end_with_parent, daemon=True).start()
