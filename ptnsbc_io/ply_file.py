"""The points of a PLY file: ASCII, or binary of both byte orders.

The vertices come first in the files of every common program. Faces and other elements after them are not read.
"""

from __future__ import annotations

import io

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array

_LONGEST_HEADER = 10_000
_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2"}
_TYPES |= {"uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


class PlyError(PtnsbcError):
    """A file that holds no points in PLY, in words that follow its name."""


def ply_points(data: bytes) -> Array:
    """Points (N, 3) [m]: the properties x, y and z of the vertices.

    Raises:
        PlyError: no PLY file, or one whose vertices have no such properties.
    """
    end = data.find(b"end_header", 0, _LONGEST_HEADER)
    first = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or first <= 0:
        raise PlyError("expected the header of a PLY file, with a line end_header")
    lines = [line.split() for line in data[:end].decode("ascii", "replace").splitlines()]
    order, (count, columns) = _order(lines), _vertices(lines)
    if not order:
        return _ascii(data[first:], count, [name for name, _ in columns])
    record = np.dtype([(name, order + kind) for name, kind in columns])
    size = count * record.itemsize
    if size > len(data) - first:
        raise PlyError(f"expected {size} bytes of vertices, found {len(data) - first}")
    found = np.frombuffer(data, record, count, first)
    return np.stack([found[axis].astype(np.float64) for axis in "xyz"], axis=1)


def _order(lines: list[list[str]]) -> str:
    """The byte order of NumPy; empty for text."""
    given = next((words[1] for words in lines if words[:1] == ["format"] and len(words) > 1), "")
    if given not in _ORDERS:
        raise PlyError(f"format {given[:40]}: expected {', '.join(_ORDERS)}")
    return _ORDERS[given]


def _vertices(lines: list[list[str]]) -> tuple[int, list[tuple[str, str]]]:
    """The number of vertices, and name and type of each of their properties."""
    elements = [at for at, words in enumerate(lines) if words[:1] == ["element"]]
    first = lines[elements[0]] if elements else []
    if len(first) != 3 or first[1] != "vertex":
        raise PlyError("expected vertices as the first element")
    if not (first[2].isascii() and first[2].isdecimal() and 0 < int(first[2]) < 10**9):
        raise PlyError(f"element vertex {first[2][:40]}: expected a whole number above 0")
    columns: list[tuple[str, str]] = []
    for words in lines[elements[0] + 1 : (*elements, len(lines))[1]]:
        if words[:1] != ["property"]:
            continue
        if len(words) != 3 or words[1] not in _TYPES:
            raise PlyError(f"{' '.join(words)[:60]}: expected a property of one number")
        columns.append((words[2], _TYPES[words[1]]))
    names = [name for name, _ in columns]
    if len(set(names)) != len(names) or not {"x", "y", "z"} <= set(names):
        raise PlyError("expected properties x, y and z of the vertices, each name once")
    return int(first[2]), columns


def _ascii(data: bytes, count: int, names: list[str]) -> Array:
    try:
        columns = [names.index(axis) for axis in "xyz"]
        found = np.loadtxt(io.BytesIO(data), usecols=columns, ndmin=2, max_rows=count)
    except ValueError:
        raise PlyError("expected a row of numbers for each vertex") from None
    if len(found) != count:
        raise PlyError(f"{len(found)} vertices: expected {count}, as the header says")
    return np.asarray(found, dtype=np.float64)
