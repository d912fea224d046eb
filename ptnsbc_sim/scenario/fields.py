"""The types of the values in a scenario file, and the base class of its blocks.

A key ends in its unit. A value may repeat the unit ("5 s"); a wrong unit is refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache, wraps
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

LARGEST = 1e12
"""Size of the largest number of a quantity: the laws square and cube them."""

AUTO = "auto"
"""The value of a key that is left to us."""

MOST_SAMPLES = 200_000
"""Characters of a CSV file at most."""

# Suffix of a key -> its unit as we write it. Longer suffixes first: `_m_s2` also ends in `_s2`.
_UNITS = {
    "_n2_s": "N^2 s",
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


@cache
def unit_of(key: str) -> str | None:
    """The unit that the name of a key ends in, None for a key without one."""
    for suffix, unit in _UNITS.items():
        if key.endswith(suffix):
            return unit
    return None


def number_in(unit: str | None) -> str:
    """The expectation of a number in a unit."""
    return "a number" if unit is None else f'a number in {unit}, or text such as "1.5 {unit}"'


def _spelling(unit: str) -> str:
    """Spellings of one unit made equal: `m/s²`, `m/s2`, `m / s^2`."""
    return re.sub(r"[\s*·^]", "", unit.replace("²", "2")).lower()


def without_unit(value: Any, unit: str, below: tuple[str | int, ...] = ()) -> Any:
    """A value with "number unit" texts, also inside lists and mappings, made numbers."""
    if isinstance(value, list):
        return [without_unit(item, unit, (*below, index)) for index, item in enumerate(value)]
    if isinstance(value, dict):
        return {key: without_unit(item, unit, (*below, key)) for key, item in value.items()}
    if not isinstance(value, str):
        return value
    match = _QUANTITY.fullmatch(value)
    if match and _spelling(match[2]) == _spelling(unit):
        number = float(match[1])
        return int(number) if number.is_integer() else number
    if match:
        expected = f'the unit {unit}, as in "{match[1]} {unit}", or the number alone'
    else:
        expected = number_in(unit)
    raise PydanticCustomError(
        "quantity", "expected {expected}", {"below": below, "value": value, "expected": expected}
    )


_WAVE = re.compile(rf"\s*({_NUMBER})\s*(sin|cos)?\s*")


def three(value: Any) -> Any:
    """A list of three as a tuple; anything else is refused in words."""
    if isinstance(value, list) and len(value) == 3:
        return tuple(value)
    raise PydanticCustomError("three", "expected a list of three numbers", {"value": value})


def _wave(value: Any) -> Any:
    """A disturbance: a number is constant, "0.2 cos" and "0.1 sin" have a frequency of 1 rad/s."""
    written = isinstance(value, str | int | float) and not isinstance(value, bool)
    match = _WAVE.fullmatch(str(value)) if written else None
    if match is None:
        raise PydanticCustomError(
            "wave", 'expected a number, "0.2 sin" or "0.2 cos"', {"value": value}
        )
    amount = float(match[1])
    if abs(amount) > LARGEST:
        expected = f"expected an amount from {-LARGEST:g} to {LARGEST:g}"
        raise PydanticCustomError("wave", "{expected}", {"value": value, "expected": expected})
    return Wave(amount=amount, shape=match[2] or "constant")


_Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Number = Annotated[_Finite, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[_Finite, Field(gt=0, le=LARGEST)]
NotNegative = Annotated[_Finite, Field(ge=0, le=LARGEST)]
Share = Annotated[_Finite, Field(ge=0, lt=1)]
Residual = Annotated[_Finite, Field(gt=0, lt=1)]
Count = Annotated[int, Field(strict=True, gt=0)]
UavId = Annotated[int, Field(strict=True, ge=1, le=254)]
Name = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9_-]+$", max_length=64)]
Flag = Annotated[bool, Field(strict=True)]
Vec3 = Annotated[tuple[Number, Number, Number], BeforeValidator(three)]
NotNegativeVec3 = Annotated[tuple[NotNegative, NotNegative, NotNegative], BeforeValidator(three)]
PositiveVec3 = Annotated[tuple[Positive, Positive, Positive], BeforeValidator(three)]


class Block(BaseModel):
    """A mapping of the file: unknown keys refused, texts with units made numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _prepare(cls, tree: Any) -> Any:
        if not isinstance(tree, dict):
            return tree
        for key in tree:
            if key not in cls.model_fields:
                about = {
                    "below": (key,),
                    "known": (*cls.model_fields,),
                    "deep": (*keys_below(cls),),
                }
                raise PydanticCustomError("unknown_key", "unknown key", about)
        units = {
            key: unit
            for key, value in tree.items()
            if value != AUTO and not key.startswith("disturbance") and (unit := unit_of(key))
        }
        return {**tree, **{key: without_unit(tree[key], units[key], (key,)) for key in units}}


def keys_below(block: type[Block]) -> Iterator[str]:
    """The dotted keys of the blocks below a block; entries of lists have none."""
    for name, field in block.model_fields.items():
        kind = field.annotation
        for one in get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,):
            if isinstance(one, type(Block)):
                yield from (f"{name}.{key}" for key in (*one.model_fields, *keys_below(one)))


_Block = TypeVar("_Block", bound=Block)
_Result = TypeVar("_Result")


def replaced(block: _Block, keys: Mapping[str, Any]) -> _Block:
    """A block with the values of dotted keys replaced; nothing is validated again."""
    changes: dict[str, Any] = {}
    for key, value in keys.items():
        first, _, below = key.partition(".")
        if below:
            value = replaced(changes.get(first, getattr(block, first)), {below: value})
        changes[first] = value
    return block.model_copy(update=changes)


def kept(function: Callable[[_Block], _Result]) -> Callable[[_Block], _Result]:
    """Keep the newest result, as long as it is asked for the same block: all UAVs and the verdict ask for it."""
    newest: list[tuple[_Block, _Result]] = []

    @wraps(function)
    def result_for(block: _Block) -> _Result:
        for known, result in newest:
            if known is block:
                return result
        newest[:] = [(block, result := function(block))]
        return result

    return result_for


class Wave(BaseModel):
    """One component of a disturbance: amount, amount sin(t) or amount cos(t)."""

    model_config = ConfigDict(frozen=True)

    amount: Number
    shape: str


_AnyWave = Annotated[Wave, BeforeValidator(_wave)]
Waves = Annotated[tuple[_AnyWave, _AnyWave, _AnyWave], BeforeValidator(three)]
