"""Quantities: a key ends in its unit, a value may repeat it ("5 s"); a wrong one is refused."""

from __future__ import annotations

import re
from typing import Any

from pydantic_core import PydanticCustomError

# Suffix of a key -> its unit as we write it. Longer suffixes first: `_m_s2` also ends in `_s2`.
_UNITS = {
    "_rad_s2": "rad/s^2",
    "_kg_m2": "kg m^2",
    "_rad_s": "rad/s",
    "_m_s2": "m/s^2",
    "_m_s": "m/s",
    "_1_s": "1/s",
    "_rad": "rad",
    "_kg": "kg",
    "_hz": "Hz",
    "_nm": "N m",
    "_n": "N",
    "_s": "s",
    "_m": "m",
}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*(\S.*?)\s*")


def unit_of(key: str) -> str | None:
    """The unit that the name of a key ends in, None for a key without one."""
    for suffix, unit in _UNITS.items():
        if key.endswith(suffix):
            return unit
    return None


def _plain(unit: str) -> str:
    """Spellings of one unit made equal: `m/s²`, `m/s2`, `m / s^2`."""
    return re.sub(r"[\s*·^]", "", unit.replace("²", "2")).lower()


def _number(value: Any, unit: str, below: tuple[str | int, ...]) -> Any:
    if isinstance(value, list):
        return [_number(item, unit, (*below, index)) for index, item in enumerate(value)]
    if isinstance(value, dict):
        return {key: _number(item, unit, (*below, key)) for key, item in value.items()}
    if not isinstance(value, str):
        return value
    match = _QUANTITY.fullmatch(value)
    if match and _plain(match[2]) == _plain(unit):
        number = float(match[1])
        return int(number) if number.is_integer() else number
    if match:
        expected = f'the unit {unit}, as in "{match[1]} {unit}", or the number alone'
    else:
        expected = f'a number in {unit}, or text such as "1.5 {unit}"'
    raise PydanticCustomError(
        "quantity", "expected {expected}", {"below": below, "value": value, "expected": expected}
    )


def strip_unit(key: str, value: Any) -> Any:
    """`value` of `key` with "number unit" texts, also inside lists and mappings, made numbers."""
    unit = unit_of(key)
    return value if unit is None else _number(value, unit, (key,))
