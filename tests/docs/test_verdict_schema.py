"""The committed JSON schema is that of the code, and verdicts keep to it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from synthetic_flights import flight

from docs.make import verdict_schema
from ptnsbc_sim.verdict import verdict_on

ROOT = Path(__file__).parents[2]


def test_committed_schema_is_that_of_the_code():
    committed = (ROOT / "docs" / "verdict.schema.json").read_text(encoding="utf-8")
    assert committed == verdict_schema.text(), "make docs"


KINDS = {
    "number": lambda value: isinstance(value, int | float) and not isinstance(value, bool),
    "integer": lambda value: isinstance(value, int) and not isinstance(value, bool),
    "boolean": lambda value: isinstance(value, bool),
    "string": lambda value: isinstance(value, str),
    "null": lambda value: value is None,
    "array": lambda value: isinstance(value, list),
    "object": lambda value: isinstance(value, dict),
}


def faults(value: Any, part: dict[str, Any], whole: dict[str, Any], where: str) -> list[str]:
    """What of a value breaks its schema; as much of draft 2020-12 as ours uses."""
    if "$ref" in part:
        return faults(value, whole["$defs"][part["$ref"].rsplit("/", 1)[1]], whole, where)
    unknown = set(part) - {"type", "enum", "properties", "required", "items", "description"}
    unknown -= {"additionalProperties", "$defs", "$schema", "title"}
    assert not unknown, f"{where}: {unknown} is not checked here"
    found = []
    if "enum" in part and value not in part["enum"]:
        found.append(f"{where}: {value!r}")
    kinds = part.get("type", [])
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if kinds and not any(KINDS[kind](value) for kind in kinds):
        return [f"{where}: {value!r} is no {kinds}"]
    if isinstance(value, list):
        for k, item in enumerate(value):
            found += faults(item, part["items"], whole, f"{where}[{k}]")
    if isinstance(value, dict):
        properties, others = part.get("properties", {}), part.get("additionalProperties")
        found += [f"{where}.{key}: missing" for key in part.get("required", ()) if key not in value]
        for key, item in value.items():
            chosen = properties.get(key, others)
            if chosen is None:
                found.append(f"{where}.{key}: not in the schema")
            else:
                found += faults(item, chosen, whole, f"{where}.{key}")
    return found


def test_verdicts_keep_to_the_schema():
    committed = json.loads((ROOT / "docs" / "verdict.schema.json").read_text(encoding="utf-8"))
    away = lambda t: np.where((t > 12.0) & (t < 18.0), 1.0, 0.0)  # noqa: E731
    second, late = (12 * 10**9, "form"), (30 * 10**9, "form")
    flights = [flight(), flight(seconds=3.0)]
    flights.append(flight({4: away}, seconds=20.0, epochs=((0, "form"), second)))
    flights.append(flight(seconds=20.0, epochs=((0, "form"), second, late)))
    flights.append(flight({2: lambda t: np.where(t > 2, math.nan, 0.0)}))
    flights.append(flight(latency={"p50": 1.0}))
    for flown in flights:
        told = json.loads(json.dumps(verdict_on(flown).as_json(), allow_nan=False))
        assert faults(told, committed, committed, "") == []
    told.pop("uavs")
    told["energy"] = "much"
    assert len(faults(told, committed, committed, "")) == 2, "a check that cannot fail is none"
