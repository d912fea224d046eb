"""A verdict per leg, its window, and the schema of its JSON."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ptnsbc_tools.tables import reasons, verdict_line
from ptnsbc_tools.verdict import VerdictError, schema, verdict_on

SECOND_S = 12.0
ROOT = Path(__file__).parents[3]


def epochs(*legs: tuple[float, str]) -> tuple[tuple[int, str], ...]:
    return tuple((round(t_s * 1e9), name) for t_s, name in legs)


@pytest.fixture
def twice(fly):
    """UAV 4 is a metre away from the second epoch on, and back `back` seconds later."""

    def flown(back: float, *more: tuple[float, str], seconds: float = 20.0):
        away = lambda t: np.where((t > SECOND_S) & (t < SECOND_S + back), 1.0, 0.0)  # noqa: E731
        legs = epochs((0.0, "form"), (SECOND_S, "form"), *more)
        return fly({4: away}, seconds=seconds, epochs=legs)

    return flown


def test_both_legs_met(twice):
    verdict = verdict_on(twice(3.0))
    assert [leg.verdict for leg in verdict.legs] == ["met", "met"]
    assert verdict.verdict == "met"
    first, second = verdict.legs
    assert (first.epoch_s, first.duration_s) == (0.0, pytest.approx(12.0))
    assert (second.epoch_s, second.duration_s) == (12.0, pytest.approx(7.99))
    assert second.uavs[3].settling_s == pytest.approx(3.0)
    assert verdict.uavs == first.uavs
    assert "10 met in 2 legs" in str(verdict_line(verdict))


def test_the_leader_follows_its_path_through_all_legs(twice):
    """Its trajectory counts from the first epoch: a new one does not begin it anew."""
    leader = verdict_on(twice(3.0)).legs[1].uavs[0]
    assert leader.start_error_m == pytest.approx(0.0, abs=1e-9)


def test_second_leg_missed(twice):
    verdict = verdict_on(twice(6.0))
    assert [leg.verdict for leg in verdict.legs] == ["met", "missed"]
    assert (verdict.verdict, verdict.exit_code) == ("missed", 1)
    (line,) = map(str, reasons(verdict))
    assert line.startswith("leg 2 from 12.00 s, UAV 4 missed: settled after 6.00 s")


def test_hold_ends_a_leg_and_is_not_judged(twice):
    verdict = verdict_on(twice(3.0, (18.0, "hold")))
    assert len(verdict.legs) == 2
    assert verdict.legs[1].duration_s == pytest.approx(6.0)


def test_a_leg_without_flight_is_void(twice):
    verdict = verdict_on(twice(0.0, (30.0, "form")))
    assert [leg.verdict for leg in verdict.legs] == ["met", "met", "void"]
    assert verdict.verdict == "void"
    assert "holds no formation flight" in verdict.legs[2].reason
    told = verdict.as_json()["legs"][2]
    assert (told["verdict"], told["uavs"]) == ("void", [])


def test_window(fly):
    """Only what is inside counts, and a window shorter than the deadline answers nothing."""
    flown = fly({2: lambda t: np.where(t > 9.0, 1.0, 0.0)})
    assert verdict_on(flown).verdict == "missed"
    assert verdict_on(replace(flown, window_s=8.0)).verdict == "met"
    short = verdict_on(replace(flown, window_s=4.0))
    assert short.verdict == "void"
    assert short.uavs[1].reason == "recording ends after 4.00 s"


def test_no_flight_at_all(fly):
    with pytest.raises(VerdictError, match="no formation flight"):
        verdict_on(fly(epochs=epochs((100.0, "form"))))


def test_committed_schema_is_that_of_the_code():
    committed = (ROOT / "docs" / "verdict.schema.json").read_text(encoding="utf-8")
    assert committed == schema.text(), (
        "python -m ptnsbc_tools.verdict.schema > docs/verdict.schema.json"
    )


KINDS = {
    "number": lambda value: isinstance(value, int | float) and not isinstance(value, bool),
    "integer": lambda value: isinstance(value, int) and not isinstance(value, bool),
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


def test_verdicts_keep_to_the_schema(fly, twice):
    committed = json.loads((ROOT / "docs" / "verdict.schema.json").read_text(encoding="utf-8"))
    flights = [fly(), twice(6.0), twice(0.0, (30.0, "form")), fly(seconds=3.0)]
    flights.append(fly({2: lambda t: np.where(t > 2, math.nan, 0.0)}))
    flights.append(fly(latency={"p50": 1.0}))
    for flown in flights:
        told = json.loads(json.dumps(verdict_on(flown).as_json(), allow_nan=False))
        assert faults(told, committed, committed, "") == []
    told.pop("uavs")
    told["energy"] = "much"
    assert len(faults(told, committed, committed, "")) == 2, "a check that cannot fail is none"
