"""std_msgs/Int64MultiArray and Float64MultiArray: rows of numbers whose layout names each of them.

layout.dim[0].label = "name name:count ..." | size = stride = length | data
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_io.wire.cdr import (
    LITTLE_ENDIAN_HEADER,
    Floats,
    WireError,
    align,
    byte_order,
    encode_string,
    float_bytes,
    pad,
    require,
    skip_string,
    string_at,
)

_WHAT = "std_msgs/MultiArray"
_LABEL_AT = 8  # after the encapsulation header and the number of dimensions


class Row(NamedTuple):
    """A decoded array of one dimension."""

    label: str
    values: NDArray[np.int64] | Floats  # (n,)


class RowTemplate:
    """Encoder of arrays with the same label and length: one prebuilt message, patched."""

    def __init__(self, label: str, length: int) -> None:
        self._length = length
        buffer = bytearray(LITTLE_ENDIAN_HEADER + struct.pack("<I", 1)) + encode_string(label)
        pad(buffer, 4)
        buffer += struct.pack("<IIII", length, length, 0, length)
        pad(buffer, 8)
        self._start = bytes(buffer)

    def integers(self, values: list[int]) -> bytes:
        """Int64MultiArray of `values`."""
        return self._start + struct.pack(f"<{self._length}q", *values)

    def floats(self, values: Floats) -> bytes:
        """Float64MultiArray of `values` (n,)."""
        return self._start + float_bytes(values, self._length, _WHAT)


def decode_integers(buf: bytes) -> Row:
    """Label and values of an Int64MultiArray."""
    return _decode(buf, "i8")


def decode_floats(buf: bytes) -> Row:
    """Label and values of a Float64MultiArray."""
    return _decode(buf, "f8")


def _decode(buf: bytes, kind: str) -> Row:
    order = byte_order(buf, _WHAT)
    require(buf, _LABEL_AT, _WHAT)
    (dimensions,) = struct.unpack_from(f"{order}I", buf, 4)
    if dimensions != 1:
        raise WireError(f"{_WHAT}: {dimensions} dimensions: expected 1")
    label = string_at(buf, order, _LABEL_AT, _WHAT)
    count_at = align(skip_string(buf, order, _LABEL_AT, _WHAT), 4) + 12
    require(buf, count_at + 4, _WHAT)
    (count,) = struct.unpack_from(f"{order}I", buf, count_at)
    values_at = align(count_at + 4, 8)
    require(buf, values_at + 8 * count, _WHAT)
    values = np.frombuffer(buf, f"{order}{kind}", count, values_at)
    return Row(label, values.astype(values.dtype.newbyteorder("=")))
