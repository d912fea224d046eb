"""rclpy message objects to bytes that are the same on every run.

rclpy's own serialiser leaves old memory in the alignment gaps, so that bags of two equal flights would differ.
This one is slow, and serves the few messages that are built as objects (diagnostics, markers) at 5 Hz.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from ptnsbc_io.wire.cdr import LITTLE_ENDIAN_HEADER, encode_string, pad

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
    return _octet if kind == "octet" else _message


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


def _octet(out: bytearray, value: bytes) -> None:
    out += value
