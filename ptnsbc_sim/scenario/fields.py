"""The kinds of value a scenario file holds, and the base of its blocks."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    model_validator,
)
from pydantic_core import PydanticCustomError

from ptnsbc_sim.scenario.problems import similar
from ptnsbc_sim.scenario.units import strip_unit

Vector = tuple[float, float, float]

_WAVE = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(sin|cos)?\s*")


def _three(value: Any) -> Any:
    if isinstance(value, list) and len(value) == 3:
        return tuple(value)
    raise PydanticCustomError("three", "expected a list of three numbers", {"value": value})


def _wave(value: Any) -> Any:
    """A disturbance: a number is constant, "0.2 cos" and "0.1 sin" have a frequency of 1 rad/s."""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        match = None
    else:
        match = _WAVE.fullmatch(str(value))
    if match is None:
        raise PydanticCustomError(
            "wave", 'expected a number, "0.2 sin" or "0.2 cos"', {"value": value}
        )
    return Wave(amount=float(match[1]), shape=match[2] or "constant")


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Share = Annotated[Number, Field(ge=0, lt=1)]
Residual = Annotated[Number, Field(gt=0, lt=1)]
Count = Annotated[int, Field(strict=True, gt=0)]
UavId = Annotated[int, Field(strict=True, ge=1, le=254)]
Name = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9_-]+$", max_length=64)]
Flag = Annotated[bool, Field(strict=True)]
Vec3 = Annotated[tuple[Number, Number, Number], BeforeValidator(_three)]
NotNegativeVec3 = Annotated[tuple[NotNegative, NotNegative, NotNegative], BeforeValidator(_three)]
PositiveVec3 = Annotated[tuple[Positive, Positive, Positive], BeforeValidator(_three)]


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
                raise PydanticCustomError(
                    "unknown_key",
                    "unknown key: {hint}",
                    {"below": (key,), "hint": similar(key, cls.model_fields)},
                )
        return {
            key: value if _holds_waves(key) else strip_unit(key, value)
            for key, value in tree.items()
        }


def _holds_waves(key: str) -> bool:
    return key.startswith("disturbance")


class Wave(BaseModel):
    """One component of a disturbance: amount, amount sin(t) or amount cos(t)."""

    model_config = ConfigDict(frozen=True)

    amount: Number
    shape: str


Disturbance = Annotated[
    tuple[
        Annotated[Wave, BeforeValidator(_wave)],
        Annotated[Wave, BeforeValidator(_wave)],
        Annotated[Wave, BeforeValidator(_wave)],
    ],
    BeforeValidator(_three),
]
