"""Reading parameters of an autopilot by name, with repeated requests when no answer arrives.

Both autopilots put integers into the float of PARAM_VALUE: PX4 puts the bits there (bytewise
encoding), ArduPilot the number (C cast).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from typing import Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.framing import V2

_RETRY_S = 0.5
_MAX_REQUESTS = 4
_PARALLEL = 4

_INTEGERS: Mapping[int, str] = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<Bxxx",
    mavlink.MAV_PARAM_TYPE_INT8: "<bxxx",
    mavlink.MAV_PARAM_TYPE_UINT16: "<Hxx",
    mavlink.MAV_PARAM_TYPE_INT16: "<hxx",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


class MavlinkParameterError(PtnsbcError):
    """A parameter has an unknown type."""


class Encoding(Enum):
    """The encoding of integers."""

    BYTEWISE = "bytewise"
    C_CAST = "C cast"


def decoded(raw: bytes, kind: int, encoding: Encoding) -> float:
    """The value of four raw bytes of `param_value`, of MAV_PARAM_TYPE `kind`."""
    if kind in _INTEGERS and encoding is Encoding.BYTEWISE:
        return float(struct.unpack(_INTEGERS[kind], raw)[0])
    if kind not in _INTEGERS and kind != mavlink.MAV_PARAM_TYPE_REAL32:
        raise MavlinkParameterError(
            f"parameter of type {kind}: expected REAL32 or an integer of 32 bits"
        )
    return float(struct.unpack("<f", raw)[0])


def raw_value(message: Any) -> bytes:
    """The four bytes of `param_value` as they were sent: a float in between may change NaN bits."""
    data: bytes = bytes(message.get_msgbuf())
    at = 10 if data[0] == V2 else 6
    return data[at : at + 4].ljust(4, b"\0")


class ParameterReader:
    """Requests parameters, a few at a time, and stores the answers.

    An autopilot does not answer for a name that it does not have: after four requests without an
    answer a parameter counts as missing.
    """

    def __init__(self, names: Sequence[str], encoding: Encoding) -> None:
        self._encoding = encoding
        self._requests = dict.fromkeys(names, 0)
        self._next_s = dict.fromkeys(names, 0.0)
        self.values: dict[str, float] = {}

    @property
    def missing(self) -> list[str]:
        """Names without an answer."""
        return [name for name in self._requests if name not in self.values]

    def done(self, now_s: float) -> bool:
        """True if every name is answered or given up."""
        return all(
            self._requests[name] >= _MAX_REQUESTS and now_s >= self._next_s[name]
            for name in self.missing
        )

    def due(self, now_s: float) -> Iterator[str]:
        """Names to request now."""
        open_names = [n for n in self.missing if self._requests[n] < _MAX_REQUESTS]
        for name in open_names[:_PARALLEL]:
            if now_s >= self._next_s[name]:
                self._requests[name] += 1
                self._next_s[name] = now_s + _RETRY_S
                yield name

    def on_param_value(self, message: Any) -> None:
        """Store a PARAM_VALUE if it was requested; only the first answer counts."""
        name = str(message.param_id)
        if self._requests.get(name) and name not in self.values:
            self.values[name] = decoded(raw_value(message), message.param_type, self._encoding)
