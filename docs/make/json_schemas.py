"""The JSON schemas, draft 2020-12: of a scenario file and of a family, for editors, and of a verdict.

Those for editors are wider than the loader, which alone decides: a key may be missing, because `extends` or a default
may give it, and `null` removes one.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import textwrap
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, TypeAdapter

from ptnsbc_sim import sweep
from ptnsbc_sim.scenario.fields import Block, Wave, unit_of
from ptnsbc_sim.scenario.model import ScenarioFile
from ptnsbc_sim.scenario.reading.places import PLACES, EarthPlace
from ptnsbc_sim.sweep.family import Family
from ptnsbc_sim.verdict.deadline import MET, MET_LATE, MISSED, VIOLATED, VOID
from ptnsbc_sim.verdict.verdict import CUT_SHORT, Verdict
from ptnsbc_tools.library import new_scenario

SCENARIO, FAMILY = new_scenario.SCHEMA, Path(sweep.__file__).with_name("family.schema.json")
VERDICT = Path(__file__).parents[1] / "verdict.schema.json"

_LINK = re.compile(r"\[([^]]*)\]\([^)]*\)")
_EXTENDS = {
    "type": "string",
    "description": "Name or path of the scenario to start from; its own keys come over it.",
}
_FUNCTION = {
    "type": "object",
    "description": "A function of yours, with its arguments.",
    "properties": {"kind": {"type": "string", "pattern": r"^.+\.py:[A-Za-z_]\w*$"}},
    "required": ["kind"],
}
_EARTH = {
    "description": "A place on the Earth: it becomes metres about mavlink.world_origin.",
    **EarthPlace.model_json_schema(),
}
_WORD = {"enum": [MET, MET_LATE, MISSED, VIOLATED, VOID]}
_OF = {"type": "integer"}
_IN_PLACE = {
    "type": "object",
    "properties": {"count": _OF, "of": _OF},
    "required": ["count", "of"],
}


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """The docstring under each field of a model, also of the models that it extends; else that of its block."""
    found: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if not issubclass(kind, Block) or kind is Block:
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
        assert isinstance(tree, ast.ClassDef)
        for field, text in pairwise(tree.body):
            if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
                continue
            if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                found[field.target.id] = " ".join(str(text.value.value).split())
    for key, value in model.model_fields.items():
        block = model if key == "kind" else next(_blocks(value.annotation), model)
        found.setdefault(key, " ".join((block.__doc__ or "").split()))
    return found


def _blocks(annotation: Any) -> Iterator[type[Block]]:
    """The blocks that a type holds, and those in them."""
    if isinstance(annotation, type) and issubclass(annotation, Block):
        yield annotation
        for field in annotation.model_fields.values():
            yield from _blocks(field.annotation)
    for part in get_args(annotation):
        yield from _blocks(part)


def described(model: type[Block]) -> dict[str, Any]:
    """JSON schema of a block and of those in it: each key with its meaning, none of them required."""
    made = model.model_json_schema()
    told = {block.__name__: meanings(block) for block in _blocks(model)}
    for name, part in ((model.__name__, made), *made["$defs"].items()):
        if "properties" not in part or name == Wave.__name__:
            continue
        part["properties"] = {
            key: _property(key, value, told[name][key]) for key, value in part["properties"].items()
        }
        part.pop("required", None)
    return made


def headed(made: dict[str, Any], title: str, description: str) -> dict[str, Any]:
    """A schema as it is published, JSON schema draft 2020-12, without the titles that pydantic gives."""
    head = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        "description": description,
    }
    rest = {key: value for key, value in made.items() if key not in (*head, "$defs")}
    return {**head, **_plain({**rest, "$defs": made["$defs"]})}


def scenario() -> dict[str, Any]:
    """The schema of a scenario file."""
    made = described(ScenarioFile)
    definitions = made["$defs"]
    definitions[Wave.__name__] = {
        "anyOf": [{"type": "number"}, {"type": "string", "pattern": r"^\S+\s*(sin|cos)?$"}]
    }
    for block, key in (("Loop", "deadline_s"), ("Communication", "tree")):
        left_to_us = definitions[block]["properties"][key]
        left_to_us["anyOf"] = [*left_to_us["anyOf"], {"const": "auto"}]
    for block, key in (("Leader", "trajectory"), ("Formation", "shape")):
        by_kind = definitions[block]["properties"][key]
        by_kind["anyOf"] = [*by_kind["anyOf"], _FUNCTION]
    made["properties"]["extends"] = _EXTENDS
    told = "One flight: UAVs, world, formation and gains. docs/scenarios.md explains every key."
    return headed(made, "Scenario of ptnsbc", told)


def _property(key: str, value: dict[str, Any], meaning: str) -> dict[str, Any]:
    """A key with its meaning; a number may be text with its unit, and null removes the key."""
    unit = unit_of(key)
    plain = isinstance(value.get("default"), bool | int | float | str) and value["default"] != ""
    default = {"default": value["default"]} if plain else {}
    inside = {name: part for name, part in value.items() if name not in ("default", "description")}
    choices = [one for one in inside.pop("anyOf", [inside]) if one != {"type": "null"}]
    discriminated = inside.get("oneOf")
    choices = list(discriminated) if discriminated else choices
    if key in PLACES and choices[0].get("prefixItems"):
        choices.append(_EARTH)
    elif key in PLACES:
        choices[0]["items"] = {"anyOf": [choices[0]["items"], _EARTH]}
    with_unit = [{"type": "string", "pattern": r"^\s*[-+.0-9]"}] if unit else []
    said = _LINK.sub(r"\1", meaning) + (f" [{unit}]" if unit else "")
    return {"description": said, **default, "anyOf": [*choices, *with_unit, {"type": "null"}]}


def _plain(part: Any) -> Any:
    """A schema without titles, whose numbers in lists may be text with a unit."""
    if isinstance(part, list):
        return [_plain(item) for item in part]
    if not isinstance(part, dict):
        return part
    kept = {
        key: value for key, value in part.items() if not isinstance(value, str) or key != "title"
    }
    if isinstance(kept.get("additionalProperties"), dict):
        kept["additionalProperties"] = {"anyOf": [kept["additionalProperties"], {"type": "null"}]}
    if "prefixItems" in kept:
        kept["items"] = False
        kept["prefixItems"] = [
            {"anyOf": [one, {"type": "string"}]} if one.get("type") == "number" else one
            for one in kept["prefixItems"]
        ]
    return {key: _plain(value) for key, value in kept.items()}


def family() -> dict[str, Any]:
    """The schema of a family file."""
    told = "Distributions of scenarios, for ptnsbc sweep --family. docs/sweeps.md explains it."
    return headed(described(Family), "Family of scenarios of ptnsbc", told)


def verdict() -> dict[str, Any]:
    """The schema of the verdict that commands print with --json."""
    made = TypeAdapter(Verdict).json_schema()
    # Both follow from the verdicts on the UAVs and are therefore no fields of the classes.
    for part in (made, made["$defs"]["LegVerdict"]):
        part["properties"] = {"verdict": _WORD, "in_place": _IN_PLACE, **part["properties"]}
        part["required"] = ["verdict", "in_place", *part["required"]]
    made["$defs"]["UavVerdict"]["properties"]["verdict"] = _WORD
    made["$defs"]["MissionLegVerdict"]["properties"]["verdict"] = {
        "enum": [*_WORD["enum"], CUT_SHORT]
    }
    told = "simulate, fleet, demo and verify with --json; they add keys of their own."
    made = _nullable(headed(made, "Verdict of ptnsbc", told))
    return dict(made)


def _nullable(part: Any) -> Any:
    """A schema in which numbers may be null: a figure that does not exist."""
    if isinstance(part, list):
        return [_nullable(item) for item in part]
    if not isinstance(part, dict):
        return part
    if part.get("type") == "number":
        return {"type": ["number", "null"]}
    kinds = part.get("anyOf", [])
    if kinds and all(list(kind) == ["type"] for kind in kinds):
        return {"type": [kind["type"] for kind in kinds]}
    return {key: _nullable(value) for key, value in part.items()}


SCHEMAS = {SCENARIO: scenario, FAMILY: family, VERDICT: verdict}
"""The committed files, and what makes them."""


def text(path: Path) -> str:
    """A schema as the committed file holds it."""
    return json.dumps(SCHEMAS[path](), indent=1, ensure_ascii=False) + "\n"
