"""The JSON schemas for editors: they accept what the loader accepts, and refuse slips of a single key."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic_flights import flight

from docs.make.json_schemas import FAMILY, SCENARIO, SCHEMAS, VERDICT
from ptnsbc_sim.scenario.reading import reader
from ptnsbc_sim.verdict import verdict_on

jsonschema = pytest.importorskip("jsonschema")
SCENARIOS = Path(__file__).parents[2] / "scenarios"
SHIPPED = [(SCENARIO, path) for path in sorted(SCENARIOS.glob("*.yaml"))]
SHIPPED += [(FAMILY, path) for path in sorted(SCENARIOS.glob("families/*.yaml"))]


def _as_json(tree: Any) -> Any:
    """As an editor sees YAML: ids are text."""
    if isinstance(tree, dict):
        return {str(key): _as_json(value) for key, value in tree.items()}
    return [_as_json(item) for item in tree] if isinstance(tree, list) else tree


@cache
def _validator(schema: Path) -> Any:
    made = SCHEMAS[schema]()
    jsonschema.Draft202012Validator.check_schema(made)
    return jsonschema.Draft202012Validator(made)


@pytest.mark.parametrize(("schema", "path"), SHIPPED, ids=lambda path: path.stem)
def test_the_shipped_files_fit_and_name_it(schema: Path, path: Path) -> None:
    text = path.read_text("utf-8")
    _validator(schema).validate(_as_json(reader.parse(text, path.name)))
    modeline = text.splitlines()[0].removeprefix("# yaml-language-server: $schema=")
    assert (path.parent / modeline).resolve() == schema


@pytest.mark.parametrize(
    "text",
    [
        "extends: paper_5\nformation: {offsets_m: {4: null}}",
        "gains: {formation: {deadline_s: auto}}",
        "timing: {duration_s: 5 s}",
        "leader: {trajectory: {kind: spiral.py:spiral, arguments: {climb_m_s: 0.1}}}",
        "formation: {shape: {kind: spiral.py:arc, radius_m: 2}}",
        "plugins: {task: mine.py:cylinder, sensor: camera}",
        "uavs: [{id: 1, position_m: [0, 1 m, 0], disturbance_m_s2: [0.2 sin, 0, 0]}]",
    ],
)
def test_what_the_loader_takes_fits(text: str) -> None:
    _validator(SCENARIO).validate(_as_json(reader.parse(text, "test")))


@pytest.mark.parametrize(
    ("schema", "text"),
    [
        (SCENARIO, "sed: 3"),
        (SCENARIO, "formation: {task: dance}"),
        (SCENARIO, "timing: {duration_s: -1}"),
        (SCENARIO, "uavs: [{id: 1, position_m: [0, 1]}]"),
        (SCENARIO, "leader: {trajectory: {kind: circle, velocity_m_s: [1, 0, 0]}}"),
        (FAMILY, "siz: 3"),
        (FAMILY, "size: [3]"),
        (FAMILY, "tree: {kinds: [ladder]}"),
        (FAMILY, "starts: {sigma_m: wide}"),
        (FAMILY, "deadline: {seconds: [1, 2, 3]}"),
    ],
)
def test_slips_are_refused(schema: Path, text: str) -> None:
    with pytest.raises(jsonschema.ValidationError):
        _validator(schema).validate(_as_json(reader.parse(text, "test")))


def test_every_key_says_what_it_means() -> None:
    family = SCHEMAS[FAMILY]()
    blocks = [family, *(part for part in family["$defs"].values() if "properties" in part)]
    for key, value in ((k, v) for block in blocks for k, v in block["properties"].items()):
        assert value["description"], key
    made = SCHEMAS[SCENARIO]()
    assert made["properties"]["seed"]["description"].startswith("Seed of all random numbers")
    turn = made["$defs"]["UavBlock"]["properties"]["attitude_rad"]["description"]
    assert turn == "Roll, pitch, yaw at the start. [rad]"


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
    committed = SCHEMAS[VERDICT]()
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
