"""Point clouds in files: PCD, PLY, LAS and LAZ, tables with rows x, y, z, and NumPy's `.npy`."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_io.number_table import read_table

_LONGEST_HEADER = 10_000
_MOST_COUNT = 10_000  # of numbers in one field
_MOST_UNPACKED = 400_000_000  # bytes
_LONGEST_S = 60.0  # to read a LAS file
_FARTHEST_M = 1e6
_PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_PLY_TYPES |= {"float": "f4", "double": "f8"}
_PLY_TYPES |= {np.dtype(kind).name: kind for kind in _PLY_TYPES.values()}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_PCD_TYPES = {"F4", "F8", *(f"{kind}{size}" for kind in "IU" for size in (1, 2, 4, 8))}
_POINTS_OF_TREE = "which octree2pointcloud MAP.bt MAP.pcd of OctoMap writes"
_OCTOMAP = {".bt": _POINTS_OF_TREE, ".ot": f"{_POINTS_OF_TREE}, after convert_octree MAP.ot MAP.bt"}


class PointCloudFileError(PtnsbcError):
    """A file that holds no point cloud, in words that follow its name."""


def read_points(suffix: str, data: bytes) -> Array:
    """Points (N, 3) [m] of a file; those that are not finite are left out.

    Args:
        suffix: of its name, as `.pcd`.
        data: its content.

    Raises:
        PointCloudFileError: the file is no such file, or has no points.
    """
    readers = {".pcd": _pcd, ".ply": _ply, ".csv": _csv, ".xyz": _csv, ".npy": _npy}
    readers |= {".las": _las, ".laz": _las}
    if suffix in _OCTOMAP:
        raise PointCloudFileError(f"an octree: expected its points, {_OCTOMAP[suffix]}")
    if suffix not in readers:
        raise PointCloudFileError(f"expected a file that ends in {', '.join(readers)}")
    points = readers[suffix](data)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        raise PointCloudFileError("no points: expected at least one with three finite numbers")
    if np.abs(points).max() > _FARTHEST_M:
        raise PointCloudFileError(
            f"expected no coordinate beyond {_FARTHEST_M:g} m: take the origin of the scenario off"
        )
    return np.asarray(points, dtype=np.float64)


def _csv(data: bytes) -> Array:
    """Rows x, y, z and what else a row may have."""
    try:
        return read_table(data.decode(), ("x", "y", "z"), loose=True)
    except UnicodeDecodeError as error:
        raise PointCloudFileError(f"byte {error.start}: expected UTF-8 text") from None
    except ValueError as error:
        raise PointCloudFileError(str(error)) from None


_LAS = """
import resource, sys, laspy, numpy
resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
cloud = laspy.read(sys.stdin.buffer)
sys.stdout.buffer.write(numpy.column_stack([cloud.x, cloud.y, cloud.z]).tobytes())
"""


def _las(data: bytes) -> Array:
    """By laspy in a process of its own, which a damaged file may end or keep for ever."""
    if not all(map(find_spec, ("laspy", "lazrs"))):
        raise PointCloudFileError('expected laspy, which reads it: pip install "ptnsbc[maps]"')
    command = [sys.executable, "-c", _LAS]
    try:
        done = subprocess.run(
            command, input=data, capture_output=True, timeout=_LONGEST_S, check=True
        )
    except subprocess.SubprocessError:
        raise PointCloudFileError("expected a LAS or LAZ file that laspy reads") from None
    return np.frombuffer(done.stdout).reshape(-1, 3)


class _Field(NamedTuple):
    """A number of a point, or several of one kind."""

    name: str
    type: str  # as NumPy names it
    size: int = 1  # numbers


def _points(
    data: bytes, fields: Sequence[_Field], count: int, *, text: bool = False, columns: bool = False
) -> Array:
    """The fields x, y and z of `count` records, in rows of text, in binary, or in binary field by field."""
    names = [field.name for field in fields]
    axes = [names.index(axis) for axis in "xyz" if axis in names]
    if len(axes) < 3 or any(fields[place].size != 1 for place in axes):
        raise PointCloudFileError("expected fields x, y and z, each of one number")
    if not text:
        size = count * sum(np.dtype(field.type).itemsize * field.size for field in fields)
        if not 0 < size <= len(data):
            raise PointCloudFileError(f"expected {size} bytes of points, found {len(data)}")
        each = count if columns else 1
        record = np.dtype([(f"{k}", one.type, (one.size * each,)) for k, one in enumerate(fields)])
        points = np.frombuffer(data, record, count // each)
        return np.stack([points[f"{k}"].ravel().astype(np.float64) for k in axes], axis=1)
    places = [sum(field.size for field in fields[:place]) for place in axes]
    rows: Array | tuple[()] = ()
    try:
        if count and data.strip():
            stream = io.BytesIO(data)
            rows = np.loadtxt(stream, usecols=places, ndmin=2, max_rows=count, comments=None)
    except ValueError:
        raise PointCloudFileError("expected a row of numbers for each point") from None
    if len(rows) != count:
        raise PointCloudFileError(f"{len(rows)} points: expected {count}, as the header says")
    return np.asarray(rows, dtype=np.float64).reshape(-1, 3)


def _ply(data: bytes) -> Array:
    """The properties x, y and z of the vertices of a PLY file.

    They come first in the files of every common program. Faces and other elements after them are not read.
    """
    end = data.find(b"end_header", 0, _LONGEST_HEADER)
    first = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or first <= 0:
        raise PointCloudFileError("expected the header of a PLY file, with a line end_header")
    lines = [line.split() for line in data[:end].decode("ascii", "replace").splitlines()]
    form = next((words[1] for words in lines if words[:1] == ["format"] and len(words) > 1), "")
    if form not in _ORDERS:
        raise PointCloudFileError(f"format {form[:40]}: expected {', '.join(_ORDERS)}")
    count, fields = _vertices(lines, _ORDERS[form])
    return _points(data[first:], fields, count, text=form == "ascii")


def _vertices(lines: list[list[str]], order: str) -> tuple[int, list[_Field]]:
    """The number of vertices, and their properties."""
    elements = [at for at, words in enumerate(lines) if words[:1] == ["element"]]
    first = lines[elements[0]] if elements else []
    if len(first) != 3 or first[1] != "vertex":
        raise PointCloudFileError("expected vertices as the first element")
    fields = []
    for words in lines[elements[0] + 1 : (*elements, len(lines))[1]]:
        if words[:1] != ["property"]:
            continue
        if len(words) != 3 or words[1] not in _PLY_TYPES:
            raise PointCloudFileError(f"{' '.join(words)[:60]}: expected a property of one number")
        fields.append(_Field(words[2], order + _PLY_TYPES[words[1]]))
    return _numbers("element vertex", first[2:])[0], fields


def _npy(data: bytes) -> Array:
    try:
        found = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    except Exception:  # its header is a text of Python
        raise PointCloudFileError("expected an array that numpy.save has written") from None
    if found.ndim != 2 or found.shape[1] < 3:
        raise PointCloudFileError("expected an array of shape (N, 3)")
    if len(found) == 3 < found.shape[1]:
        raise PointCloudFileError(
            f"an array of shape {found.shape}: expected (N, 3), a row for each point: save its transpose"
        )
    if found.dtype.kind not in "fiu":
        raise PointCloudFileError(f"{found.dtype}: expected an array of numbers")
    return found[:, :3].astype(np.float64)


def _pcd(data: bytes) -> Array:
    """The fields x, y and z of a PCD file, version 0.7."""
    end = data.find(b"\nDATA", 0, _LONGEST_HEADER)
    after = data.find(b"\n", end + 1)
    if end < 0 or after < 0:
        raise PointCloudFileError("expected the header of a PCD file, with a line DATA")
    lines = [line.split() for line in data[:after].decode("ascii", "replace").splitlines()]
    header = {words[0]: words[1:] for words in lines if words and not words[0].startswith("#")}
    for key in ("FIELDS", "SIZE", "TYPE", "POINTS", "DATA"):
        if not header.get(key):
            raise PointCloudFileError(f"expected a line {key} in the header of a PCD file")
    points, kind = _numbers("POINTS", header["POINTS"])[0], header["DATA"][0]
    rest, fields = data[after + 1 :], _fields(header)
    if kind == "binary_compressed":
        return _points(_unpacked(rest), fields, points, columns=True)
    if kind not in ("ascii", "binary"):
        raise PointCloudFileError(f"DATA {kind}: expected ascii, binary or binary_compressed")
    return _points(rest, fields, points, text=kind == "ascii")


def _unpacked(data: bytes) -> bytes:
    """What is packed by LZF behind its two sizes: runs of bytes, and copies of some that are there already."""
    size, at, out = min(int.from_bytes(data[4:8], "little"), _MOST_UNPACKED), 8, bytearray()
    end, data = len(data), data + bytes(2)  # the last token may be cut
    while len(out) < size and at < end:
        head, at = data[at], at + 1
        if head < 32:
            out += data[at : at + head + 1]
            at += head + 1
            continue
        length = (head >> 5) + 2
        if length == 9:
            length, at = length + data[at], at + 1
        first = len(out) - (((head & 31) << 8) + data[at] + 1)
        if first < 0:
            break
        copy, at = out[first : first + length], at + 1
        out += (copy * (length // len(copy) + 1))[:length]
    return bytes(out)


def _numbers(key: str, words: list[str]) -> list[int]:
    """The numbers of a line of a header, each from 0 to 999 999 999."""
    if not all(word.isascii() and word.isdecimal() and len(word) < 10 for word in words):
        raise PointCloudFileError(f"{key} {' '.join(words)[:40]}: expected whole numbers")
    return [int(word) for word in words]


def _fields(header: dict[str, list[str]]) -> list[_Field]:
    """The fields of a point, as the header of a PCD file tells them."""
    names, kinds, sizes = header["FIELDS"], header["TYPE"], _numbers("SIZE", header["SIZE"])
    counts = _numbers("COUNT", header.get("COUNT") or ["1"] * len(names))
    if not len(names) == len(kinds) == len(sizes) == len(counts):
        raise PointCloudFileError("expected as many words in FIELDS, SIZE, TYPE and COUNT")
    fields = []
    for name, kind, size, count in zip(names, kinds, sizes, counts, strict=True):
        if f"{kind}{size}" not in _PCD_TYPES:
            raise PointCloudFileError(
                f"field {name[:40]}: {kind[:8]}{size}: expected a type of PCD"
            )
        if not 1 <= count <= _MOST_COUNT:
            raise PointCloudFileError(
                f"field {name[:40]}: COUNT {count}: expected 1 to {_MOST_COUNT}"
            )
        fields.append(_Field(name, f"<{kind.lower()}{size}", count))
    return fields
