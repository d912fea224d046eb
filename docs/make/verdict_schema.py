"""`verdict.schema.json`, the JSON schema of a verdict, made from its classes."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter

from ptnsbc_sim.scenario.schema import as_text, headed
from ptnsbc_sim.verdict.deadline import MET, MET_LATE, MISSED, VIOLATED, VOID
from ptnsbc_sim.verdict.verdict import CUT_SHORT, Verdict

_WORD = {"enum": [MET, MET_LATE, MISSED, VIOLATED, VOID]}
_OF = {"type": "integer"}
_IN_PLACE = {
    "type": "object",
    "properties": {"count": _OF, "of": _OF},
    "required": ["count", "of"],
}


def schema() -> dict[str, Any]:
    """JSON schema, draft 2020-12, of the verdict that commands print with --json."""
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
    plain: dict[str, Any] = _plain(headed(made, "Verdict of ptnsbc", told))
    return plain


def _plain(part: Any) -> Any:
    """A schema in which numbers may be null: a figure that does not exist."""
    if isinstance(part, list):
        return [_plain(item) for item in part]
    if not isinstance(part, dict):
        return part
    if part.get("type") == "number":
        return {"type": ["number", "null"]}
    kinds = part.get("anyOf", [])
    if kinds and all(list(kind) == ["type"] for kind in kinds):
        return {"type": [kind["type"] for kind in kinds]}
    return {key: _plain(value) for key, value in part.items()}


def text() -> str:
    """The schema as the committed file holds it."""
    return as_text(schema())
