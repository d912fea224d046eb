"""sensor_msgs/PointCloud2 of near objects: obstacles and other UAVs inside the detection range.

We send x y z radius [m] and vx vy vz [m/s] as FLOAT32 in `header.frame_id`. On receipt the
fields are found by name, so the driver of a depth sensor may publish the topic.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_io.wire.cdr import (
    LITTLE_ENDIAN_HEADER,
    Floats,
    Stamped,
    WireError,
    align,
    byte_order,
    encode_string,
    header_bytes,
    pad,
    read_stamp,
    require,
    skip_string,
    string_at,
    write_stamp,
)

NEAR_FIELDS = ("x", "y", "z", "radius", "vx", "vy", "vz")
REQUIRED_FIELDS = NEAR_FIELDS[:4]

_WHAT = "sensor_msgs/PointCloud2"
_FLOATS = {7: "f4", 8: "f8"}  # PointField.FLOAT32, FLOAT64
_STEP = 4 * len(NEAR_FIELDS)
_LARGEST_STEP = 1 << 16  # bytes of a point


class _Field(NamedTuple):
    name: str
    offset: int
    datatype: int
    elements: int


class _Layout(NamedTuple):
    """The layout of the points of one sender, the same in all its messages."""

    fields: tuple[_Field, ...]
    big_endian: bool
    point_step: int  # [bytes]


def _our_table() -> bytes:
    """Our field table, from the number of fields to point_step; it starts aligned to 4."""
    table = bytearray(LITTLE_ENDIAN_HEADER + struct.pack("<I", len(NEAR_FIELDS)))
    for i, name in enumerate(NEAR_FIELDS):
        pad(table, 4)
        table += encode_string(name)
        pad(table, 4)
        table += struct.pack("<IBxxxI", 4 * i, 7, 1)
    table += b"\0"  # is_bigendian
    pad(table, 4)
    return bytes(table[len(LITTLE_ENDIAN_HEADER) :]) + struct.pack("<I", _STEP)


_OUR_TABLE = _our_table()


@lru_cache(maxsize=64)
def _prefix(frame_id: str) -> bytes:
    """Everything before the row step, for one frame, without stamp and width."""
    buffer = header_bytes(frame_id)
    pad(buffer, 4)
    return bytes(buffer + struct.pack("<II", 1, 0) + _OUR_TABLE)


def encode_near(stamp_ns: int, frame_id: str, rows: Floats) -> bytes:
    """PointCloud2 of `rows` (M, 7): x y z radius [m], vx vy vz [m/s]; rounded to float32."""
    if rows.ndim != 2 or rows.shape[1] != len(NEAR_FIELDS):
        raise WireError(f"{_WHAT}: rows of shape {rows.shape}: expected (M, 7)")
    buffer = bytearray(_prefix(frame_id))
    write_stamp(buffer, stamp_ns)
    struct.pack_into("<I", buffer, len(buffer) - len(_OUR_TABLE) - 4, len(rows))  # the width
    points = rows.astype("<f4").tobytes()
    buffer += struct.pack("<II", len(points), len(points))  # row_step, length of data
    buffer += points
    buffer += b"\x01"  # is_dense
    return bytes(buffer)


def decode_near(buf: bytes) -> Stamped:
    """Stamp [ns] and rows (M, 7) x y z radius [m], vx vy vz [m/s] of a PointCloud2.

    FLOAT32 and FLOAT64 fields in any order are understood and others ignored; clouds may be
    organised (height > 1) or padded. A sender without vx vy vz gives velocity 0, and so does a
    velocity that is not finite. A point whose x y z or radius is not finite is left out: a sensor
    marks "no return" that way.
    """
    order = byte_order(buf, _WHAT)
    stamp_ns = read_stamp(buf, order, 4, _WHAT)
    shape_at = align(skip_string(buf, order, 12, _WHAT), 4)
    if order == "<" and buf.startswith(_OUR_TABLE, shape_at + 8):
        return Stamped(stamp_ns, _our_rows(buf, shape_at))
    return Stamped(stamp_ns, _foreign_rows(buf, order, shape_at))


def _our_rows(buf: bytes, shape_at: int) -> Floats:
    """The rows of a message with our field table, at a tenth of the cost of a lookup of the fields."""
    height, width = _integers(buf, "<", shape_at, 2)
    layout_at = shape_at + 8 + len(_OUR_TABLE)
    row_step, size = _integers(buf, "<", layout_at, 2)
    if height != 1:
        return _foreign_rows(buf, "<", shape_at)
    require(buf, layout_at + 8 + size + 1, _WHAT)
    _check_size(height, width, _STEP, row_step, size)
    numbers = np.frombuffer(buf, "<f4", width * len(NEAR_FIELDS), layout_at + 8)
    with np.errstate(invalid="ignore"):  # of a signalling NaN, which is left out like any other
        rows = numbers.reshape(width, len(NEAR_FIELDS)).astype(np.float64)
    return _usable(rows)


def _foreign_rows(buf: bytes, order: str, shape_at: int) -> Floats:
    height, width, count = _integers(buf, order, shape_at, 3)
    fields, end = _read_fields(buf, order, shape_at + 12, count)
    require(buf, end + 1, _WHAT)
    layout_at = align(end + 1, 4)
    point_step, row_step, size = _integers(buf, order, layout_at, 3)
    data_at = layout_at + 12
    require(buf, data_at + size + 1, _WHAT)
    layout = _Layout(fields, bool(buf[end]), point_step)
    _check_size(height, width, layout.point_step, row_step, size)
    points = np.ndarray(
        (height, width), _point_type(layout), buf, data_at, (row_step, layout.point_step)
    )
    return _usable(_near_columns(points.reshape(-1)))


def _integers(buf: bytes, order: str, offset: int, count: int) -> tuple[int, ...]:
    require(buf, offset + 4 * count, _WHAT)
    return struct.unpack_from(f"{order}{count}I", buf, offset)


def _read_fields(buf: bytes, order: str, offset: int, count: int) -> tuple[tuple[_Field, ...], int]:
    """The field table that starts at `offset`, and the offset after it."""
    fields = []
    for _ in range(count):
        name_at = align(offset, 4)
        name = string_at(buf, order, name_at, f"{_WHAT} field name")
        at = align(skip_string(buf, order, name_at, _WHAT), 4)
        require(buf, at + 12, _WHAT)
        start, datatype, elements = struct.unpack_from(f"{order}IBxxxI", buf, at)
        fields.append(_Field(name, start, datatype, elements))
        offset = at + 12
    return tuple(fields), offset


def _check_size(height: int, width: int, point_step: int, row_step: int, size: int) -> None:
    if point_step > _LARGEST_STEP:
        raise WireError(f"{_WHAT}: point_step={point_step}: expected {_LARGEST_STEP} at most")
    if height * width == 0:
        return
    if row_step < width * point_step:
        raise WireError(f"{_WHAT}: row_step={row_step}: expected >= {width} x {point_step} bytes")
    needed = (height - 1) * row_step + width * point_step
    if size < needed:
        raise WireError(f"{_WHAT}: {size} bytes of data: expected {needed} for {height}x{width}")


@lru_cache(maxsize=64)
def _point_type(layout: _Layout) -> np.dtype[np.void]:
    """Structured dtype that picks the near fields out of one point of `layout`."""
    known = {field.name: field for field in layout.fields if field.name in NEAR_FIELDS}
    missing = [name for name in REQUIRED_FIELDS if name not in known]
    if missing:
        names = ", ".join(field.name for field in layout.fields) or "none"
        raise WireError(f"{_WHAT}: no field {', '.join(missing)} among {names}")
    order = ">" if layout.big_endian else "<"
    for field in known.values():
        _check_field(field, layout.point_step)
    return np.dtype(
        {
            "names": list(known),
            "formats": [order + _FLOATS[field.datatype] for field in known.values()],
            "offsets": [field.offset for field in known.values()],
            "itemsize": layout.point_step,
        }
    )


def _check_field(field: _Field, point_step: int) -> None:
    where = f"{_WHAT}: field {field.name}"
    kind = _FLOATS.get(field.datatype)
    if kind is None:
        raise WireError(f"{where}: datatype {field.datatype}: expected 7 (FLOAT32) or 8 (FLOAT64)")
    if field.elements != 1:
        raise WireError(f"{where}: count={field.elements}: expected 1")
    if field.offset + int(kind[1]) > point_step:
        raise WireError(f"{where}: offset {field.offset}: expected inside point_step={point_step}")


def _near_columns(points: NDArray[np.void]) -> Floats:
    rows = np.zeros((len(points), len(NEAR_FIELDS)))
    for i, name in enumerate(NEAR_FIELDS):
        if name in (points.dtype.names or ()):
            with np.errstate(invalid="ignore"):
                rows[:, i] = points[name]
    return rows


def _usable(rows: Floats) -> Floats:
    """`rows` (M, 7) without those that mark "no return", unknown velocities set to zero."""
    finite = np.isfinite(rows)
    if finite.all():
        return rows
    rows[:, 4:][~finite[:, 4:]] = 0.0
    return rows[finite[:, :4].all(axis=1)]
