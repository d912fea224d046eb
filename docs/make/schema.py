"""One row per key of a scenario file: type, unit, range and default from the schema, meaning from the source."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, TypeAdapter

from docs.make.json_schemas import meanings
from ptnsbc_sim.scenario.fields import LARGEST, Block, Name, Wave, unit_of

REQUIRED = "required"
_MORE_UNITS = {"_deg": "°", "_percent": "%"}  # of keys whose values take no unit
_NAME_PATTERN: str = TypeAdapter(Name).json_schema()["pattern"]

Schema = Mapping[str, Any]


class Row(NamedTuple):
    """One key."""

    key: str  # dotted, below its block
    type: str
    unit: str
    range: str
    default: str
    meaning: str


def rows(model: type[BaseModel], prefix: str = "", note: str = "") -> Iterator[Row]:
    """A row for every key of a block, those of the blocks in it after their own."""
    schema, meaning = model.model_json_schema(), meanings(model)
    for name, field in model.model_fields.items():
        prop = _resolved(schema["properties"][name], schema)
        unit = _unit(name)
        default = (
            REQUIRED
            if field.is_required()
            else _shown(field.get_default(call_default_factory=True))
        )
        inner = list(_blocks(field.annotation))
        if inner and default not in (REQUIRED, "none"):
            default = ""  # that of its keys
        text = f"{note}{meaning[name]}"
        yield Row(
            f"{prefix}{name}", _type(prop, schema, inner), unit, _range(prop, schema), default, text
        )
        for block in inner:
            among = f"*{_kind(block)}* " if len(inner) > 1 else ""
            yield from rows(block, f"{prefix}{name}{_step(prop)}.", among)


def _resolved(prop: Schema, schema: Schema) -> Schema:
    """`prop` without null among its choices, and with its reference followed."""
    choices = [one for one in prop.get("anyOf", ()) if one.get("type") != "null"]
    if choices:
        return _resolved({**prop, **choices[0], "anyOf": ()}, schema)
    reference = prop.get("$ref")
    return schema["$defs"][reference.rpartition("/")[2]] if reference else prop


def _blocks(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, Block):
        yield annotation
    for part in get_args(annotation):
        yield from _blocks(part)


def _kind(block: type[BaseModel]) -> str:
    word, *_ = get_args(block.model_fields["kind"].annotation)
    return str(word)


def _step(prop: Schema) -> str:
    """The text between the key of a block and the keys in it, besides the dot."""
    if prop.get("type") == "array":
        return "[]"
    return ".N" if isinstance(prop.get("additionalProperties"), dict) else ""


def _unit(key: str) -> str:
    known = unit_of(key) or next((u for end, u in _MORE_UNITS.items() if key.endswith(end)), "")
    return known.replace("^2", "²")


def _type(prop: Schema, schema: Schema, inner: list[type[BaseModel]]) -> str:
    if inner:
        return {"[]": "list of blocks", ".N": "blocks by id", "": "block"}[_step(prop)]
    if "enum" in prop or "const" in prop:
        return "word"
    kind = prop.get("type", "")
    if kind == "array":
        return _array(prop, schema)
    if kind == "object":
        value = prop["additionalProperties"]
        return "keys and values" if value is True else f"{_of_id(_type(value, schema, []))} by id"
    if kind == "string":
        return "name" if prop.get("pattern") == _NAME_PATTERN else "text"
    return {"number": "number", "integer": "whole", "boolean": "true, false"}[kind]


def _array(prop: Schema, schema: Schema) -> str:
    parts = prop.get("prefixItems")
    if parts is None:
        return f"list of {_plural(_type(_resolved(prop['items'], schema), schema, []))}"
    first = _resolved(parts[0], schema)
    if first.get("title") == Wave.__name__:
        return 'three of number, `"0.2 sin"`, `"0.2 cos"`'
    return "vector" if len(parts) == 3 else "pair of ids"


def _of_id(word: str) -> str:
    return "id" if word == "whole" else word


def _plural(word: str) -> str:
    return "pairs of ids" if word == "pair of ids" else f"{_of_id(word)}s"


def _range(prop: Schema, schema: Schema) -> str:
    if "enum" in prop or "const" in prop:
        return ", ".join(f"`{word}`" for word in prop.get("enum") or [prop["const"]])
    if prop.get("pattern") == _NAME_PATTERN:
        return f"letters, digits, `_`, `-`; at most {prop['maxLength']}"
    inside = prop.get("items") or next(iter(prop.get("prefixItems", ())), None)
    value = prop.get("additionalProperties")
    inside = _resolved(inside or (value if isinstance(value, dict) else {}), schema)
    if inside and "properties" not in inside:
        found = _range(inside, schema).removeprefix("each ")
        return found and f"each {found}"
    return _bounds(prop)


def _bounds(prop: Schema) -> str:
    """The range of a number, without the limits that every number has."""
    low, above = prop.get("minimum"), prop.get("exclusiveMinimum")
    high, below = prop.get("maximum"), prop.get("exclusiveMaximum")
    low = None if low == -LARGEST else low
    high = None if high == LARGEST else high
    if low is not None and high is not None:
        return f"{_number(low)} to {_number(high)}"
    said = []
    if low is not None:
        said.append(f"≥ {_number(low)}")
    elif above is not None:
        said.append(f"> {_number(above)}")
    if high is not None:
        said.append(f"≤ {_number(high)}")
    elif below is not None:
        said.append(f"< {_number(below)}")
    return ", ".join(said)


def _number(value: float) -> str:
    if isinstance(value, int):
        return str(value)
    return f"{value:.9g}" if abs(value) < 1e5 else f"{value:.0e}".replace("e+0", "e")


def _shown(value: Any) -> str:
    """A default as the file would have it."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return _number(value)
    if isinstance(value, Wave):
        return _number(value.amount)
    if isinstance(value, tuple):
        return f"[{', '.join(_shown(one) for one in value)}]"
    return f"`{value}`" if value else "empty"
