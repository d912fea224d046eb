"""A chunk of a sweep: the rows of some draws as the bytes of a Parquet file.

What goes in and out is plain: the plan as JSON text, the number of the chunk, bytes.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ptnsbc_core.compile_cache import source_digest
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario.fields import unit_of
from ptnsbc_sim.swarm import HeadlessFlight
from ptnsbc_sim.sweep.draws import SweepAxis
from ptnsbc_sim.sweep.dry_run import dry_run_says
from ptnsbc_sim.sweep.family import family_from_text
from ptnsbc_sim.sweep.family_draw import family_columns
from ptnsbc_sim.sweep.plan import SweepPlan, Value, axis_values
from ptnsbc_sim.sweep.rows import UNITS, SweepRow, fly_draw, not_flown

if TYPE_CHECKING:
    import pyarrow as pa

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
    """Fly all draws of a chunk, one after the other in the same memory.

    Args:
        plan_json: `SweepPlan.to_json()`.
        index: number of the chunk.

    Returns:
        A Parquet file with the rows of its UAVs; a draw that cannot be flown has one row with the cause.
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


@lru_cache(maxsize=2)
def schema(plan: SweepPlan) -> pa.Schema:
    """Columns of the table, units in the metadata of each, plan and versions in that of the file."""
    import pyarrow as pa

    types = {"int": pa.int64(), "float": pa.float64(), "str": pa.string(), "bool": pa.bool_()}
    columns = [
        pa.field(name, types[kind], metadata=_unit(unit_of(name.rpartition(".")[2]) or ""))
        for name, kind in drawn_columns(plan).items()
    ]
    for field in fields(SweepRow):
        kind = str(field.type).partition(" ")[0]
        columns.append(pa.field(field.name, types[kind], metadata=_unit(UNITS[field.name])))
    return pa.schema(
        columns, metadata={"ptnsbc.plan": plan.to_json(), "ptnsbc.made_by": made_by(plan)}
    )


def drawn_columns(plan: SweepPlan) -> dict[str, str]:
    """Columns of what is drawn, and the kind of each: int, float, str or bool."""
    found = dict(family_columns(family_from_text(plan.family))) if plan.family else {}
    found |= {axis.key: _kind(axis) for axis in plan.axes}
    return {f"{DRAWN}{key}": kind for key, kind in found.items()}


def _kind(axis: SweepAxis) -> str:
    kinds = {type(value) for value in axis.values}
    if axis.random or (kinds <= {int, float} and kinds != {int}):
        return "float"
    return {int: "int", bool: "bool"}.get(kinds.pop(), "str") if len(kinds) == 1 else "str"


def _unit(unit: str) -> dict[str, str]:
    return {"unit": unit} if unit else {}


def made_by_others(chunk: Path, today: str) -> bool:
    """True if the flights in the file of a chunk were flown by other laws or library versions than `made_by` says."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        metadata = pq.read_schema(chunk).metadata or {}
    except (OSError, pa.ArrowInvalid):  # a damaged file is nobody's
        return True
    return metadata.get(b"ptnsbc.made_by") != today.encode()


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
) -> pa.Table:
    import pyarrow as pa

    columns: dict[str, list[Any]] = {}
    for name, kind in drawn_columns(plan).items():
        cell = {"int": int, "float": float, "bool": bool}.get(kind, str)
        values = [of.get(name.removeprefix(DRAWN)) for of in drawn]
        columns[name] = [None if value is None else cell(value) for value in values]
    columns |= {one.name: [getattr(row, one.name) for row in rows] for one in fields(SweepRow)}
    found = schema(plan)
    return pa.Table.from_arrays(
        [_array(columns[one.name], one.type) for one in found], schema=found
    )


def _array(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    """As `pa.array(values, kind)`, which imports pandas to look at a list: a third of a second in every worker."""
    import pyarrow as pa

    there = np.array([value is not None for value in values], dtype=bool)
    if pa.types.is_string(kind):
        words = [b"" if value is None else value.encode() for value in values]
        ends = np.cumsum([0, *map(len, words)], dtype=np.int32)
        content = [pa.py_buffer(ends), pa.py_buffer(b"".join(words))]
    else:
        numbers = np.array([0 if value is None else value for value in values])
        if pa.types.is_boolean(kind):
            numbers = np.packbits(numbers.astype(bool), bitorder="little")
        else:
            numbers = numbers.astype(kind.to_pandas_dtype())
        content = [pa.py_buffer(numbers)]
    bits = None if there.all() else pa.py_buffer(np.packbits(there, bitorder="little"))
    return pa.Array.from_buffers(kind, len(values), [bits, *content])


def _parquet(table: pa.Table) -> bytes:
    import pyarrow.parquet as pq

    out = BytesIO()
    pq.write_table(table, out, compression="zstd")
    return out.getvalue()


def join_chunks(plan: SweepPlan, chunks: Iterable[bytes]) -> bytes:
    """The table of a sweep from its chunks, in their order."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    tables = [pq.read_table(BytesIO(chunk)) for chunk in chunks]
    whole = pa.concat_tables(tables) if tables else schema(plan).empty_table()
    return _parquet(whole.replace_schema_metadata(schema(plan).metadata))
