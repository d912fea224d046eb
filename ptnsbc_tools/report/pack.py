"""Numbers for the page: one gzip stream of a JSON text and the float32 arrays it points into.

uint32 length of the text | text, UTF-8, filled up to 4 bytes | float32, little-endian
"""

from __future__ import annotations

import base64
import gzip
import json
import struct
from typing import Any

import numpy as np

from ptnsbc_core.types import Array


class Pack:
    """Collects arrays; a reference [offset, length] takes the place of each in the JSON."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._floats = 0

    def add(self, values: Array) -> list[int]:
        """Where `values` (any shape, rows first) will be found, in floats."""
        raw = np.ascontiguousarray(values, dtype="<f4").tobytes()
        reference = [self._floats, len(raw) // 4]
        self._parts.append(raw)
        self._floats += reference[1]
        return reference

    def encode(self, text: dict[str, Any]) -> str:
        """All of it in base64."""
        head = json.dumps(text, allow_nan=False, separators=(",", ":")).encode()
        head += b" " * (-len(head) % 4)
        return compressed(struct.pack("<I", len(head)) + head + b"".join(self._parts))


def compressed(data: bytes) -> str:
    """Gzip in base64, without the time of day."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode("ascii")
