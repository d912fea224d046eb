"""Common Data Representation, the bytes ROS 2 puts on the wire (XCDR1, plain CDR), and rclpy's objects in them.

A message is a 4-byte encapsulation header (representation id, options) and the fields, each
aligned to its own size *counted from after that header*. We write little-endian and fill alignment
gaps with zeros. rclpy leaves old memory in the gaps, so its bytes differ from run to run, and bags of two equal
flights would differ.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import SECOND_NS

Floats = NDArray[np.float64]

LITTLE_ENDIAN_HEADER = b"\x00\x01\x00\x00"

_BODY = 4  # the encapsulation header; alignment starts after it
_BYTE_ORDERS = {b"\x00\x01": "<", b"\x00\x00": ">"}
_LITTLE_FLOAT64 = np.dtype("<f8")
TIME = {order: struct.Struct(f"{order}iI") for order in "<>"}  # builtin_interfaces/Time

_Writer = Callable[[bytearray, Any], None]
_PRIMITIVES = {
    "boolean": "<?",
    "int8": "<b",
    "uint8": "<B",
    "int16": "<h",
    "uint16": "<H",
    "int32": "<i",
    "uint32": "<I",
    "int64": "<q",
    "uint64": "<Q",
    "float": "<f",
    "double": "<d",
}
_SEQUENCE = re.compile(r"sequence<(?P<item>[^,>]+)(, \d+)?>")
_ARRAY = re.compile(r"(?P<item>.+)\[\d+\]")


class WireError(PtnsbcError):
    """A buffer is not the expected message, or CDR cannot carry a value."""


class Stamped(NamedTuple):
    """A decoded message: its header stamp and its numbers."""

    stamp_ns: int  # [ns] since the epoch of the sender's clock
    values: Floats  # shape, units and frame: see the decoder


def byte_order(buf: bytes, what: str) -> str:
    """`<` or `>` (as struct writes it) from the encapsulation header of `buf`."""
    order = _BYTE_ORDERS.get(buf[:2])
    if order is None:
        found = bytes(buf[:2]).hex() or "nothing"
        raise WireError(f"{what}: encapsulation {found}: expected 0001 or 0000 (plain CDR, XCDR1)")
    return order


def split_stamp(stamp_ns: int) -> tuple[int, int]:
    """Seconds and nanoseconds of builtin_interfaces/Time; its seconds are 32 bits wide."""
    seconds, nanoseconds = divmod(stamp_ns, SECOND_NS)
    if not -(2**31) <= seconds < 2**31:
        raise WireError(f"stamp {stamp_ns} ns: expected seconds within 32 bits")
    return seconds, nanoseconds


@lru_cache(maxsize=8)  # the messages of one tick have the same stamp
def stamp_bytes(stamp_ns: int) -> bytes:
    """The builtin_interfaces/Time of a little-endian message."""
    return TIME["<"].pack(*split_stamp(stamp_ns))


def cut(buf: bytes, what: str, size: int) -> WireError:
    """The error of a message that ends before `size` bytes."""
    return WireError(f"{what}: {len(buf)} bytes: expected at least {size}, the message is cut")


class Reader:
    """Reads the fields of a message one after the other; WireError where they end too early."""

    def __init__(self, buf: bytes, what: str, at: int = _BODY) -> None:
        """`what`: type of the message, for errors; `at`: where the first field begins."""
        self._buf, self._what = buf, what
        self.order = byte_order(buf, what)
        """`<` or `>`, as struct writes it."""
        self.at = at

    def take(self, size: int, alignment: int = 1) -> bytes:
        """The next `size` bytes, which begin at a multiple of `alignment`."""
        start = self.at + (_BODY - self.at) % alignment
        self.at = start + size
        if len(self._buf) < self.at:
            raise cut(self._buf, self._what, self.at)
        return self._buf[start : self.at]

    def numbers(self, letters: str, alignment: int = 4) -> tuple[Any, ...]:
        """Numbers in the letters of struct."""
        layout = _layout(self.order + letters)
        return layout.unpack(self.take(layout.size, alignment))

    def stamp(self) -> int:
        """A builtin_interfaces/Time [ns]."""
        seconds, nanoseconds = self.numbers("iI")
        return int(seconds * SECOND_NS + nanoseconds)

    def text(self) -> str:
        """A string."""
        raw = self.take(*self.numbers("I"))
        try:
            return raw.rstrip(b"\0").decode()
        except UnicodeDecodeError:
            raise WireError(
                f"{self._what}: a string before byte {self.at}: expected UTF-8"
            ) from None


_layout = lru_cache(maxsize=64)(struct.Struct)


def encode_string(text: str) -> bytes:
    """Length, UTF-8 bytes and the closing NUL, to be placed at an offset aligned to 4."""
    raw = text.encode()
    if b"\0" in raw:
        raise WireError(f"string {text!r}: expected no NUL inside")
    return struct.pack("<I", len(raw) + 1) + raw + b"\0"


@lru_cache(maxsize=512)  # of a status most strings are those of the one before
def aligned_string(text: str) -> bytes:
    """A string and the zeros up to the next one or a number; it begins aligned to 4."""
    encoded = encode_string(text)
    return encoded + bytes(-len(encoded) % 4)


def header_bytes(frame_id: str) -> bytearray:
    """The start of every stamped message: encapsulation and std_msgs/Header with a zero stamp."""
    return bytearray(LITTLE_ENDIAN_HEADER + bytes(8) + encode_string(frame_id))


def pad(buffer: bytearray, size: int) -> None:
    """Fill `buffer` with zeros up to the alignment of a field of `size` bytes."""
    buffer.extend(bytes((_BODY - len(buffer)) % size))


def float_bytes(values: Floats, count: int, what: str) -> bytes:
    """`values` as little-endian float64; WireError unless there are exactly `count`."""
    try:
        # rarely; the conversion is expensive
        if getattr(values, "dtype", None) is not _LITTLE_FLOAT64:
            values = np.ascontiguousarray(values, "<f8")
        raw = values.tobytes()
    except (TypeError, ValueError) as error:
        raise WireError(f"{what}: expected {count} numbers ({error})") from None
    if len(raw) != 8 * count:
        raise WireError(f"{what}: shape {np.shape(values)}: expected ({count},)")
    return raw


def encode(message: Any) -> bytes:
    """Plain CDR, little-endian, zeros in the gaps."""
    out = bytearray(LITTLE_ENDIAN_HEADER)
    _message(out, message)
    return bytes(out)


def _message(out: bytearray, message: Any) -> None:
    kind: Any = type(message)
    for name, write in _plan(kind):
        write(out, getattr(message, name))


@lru_cache(maxsize=64)
def _plan(kind: Any) -> tuple[tuple[str, _Writer], ...]:
    """The fields of a class of rclpy, and what writes each."""
    fields: dict[str, str] = kind.get_fields_and_field_types()
    return tuple((name, _writer(text)) for name, text in fields.items())


def _writer(kind: str) -> _Writer:
    if sequence := _SEQUENCE.fullmatch(kind):
        return _items(_writer(sequence["item"]), counted=True)
    if array := _ARRAY.fullmatch(kind):
        return _items(_writer(array["item"]), counted=False)
    if kind in _PRIMITIVES:
        return _number(struct.Struct(_PRIMITIVES[kind]))
    if kind.startswith("string"):
        return _text
    return bytearray.extend if kind == "octet" else _message


def _items(write: _Writer, counted: bool) -> _Writer:
    def items(out: bytearray, values: Any) -> None:
        if counted:
            pad(out, 4)
            out += struct.pack("<I", len(values))
        for value in values:
            write(out, value)

    return items


def _number(layout: struct.Struct) -> _Writer:
    def number(out: bytearray, value: Any) -> None:
        pad(out, layout.size)
        out += layout.pack(value)

    return number


def _text(out: bytearray, value: str) -> None:
    pad(out, 4)
    out += encode_string(value)
