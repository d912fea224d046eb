"""Errors in a scenario file, in one line: file, key path, value, expectation, way out."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario.fields import number_in, unit_of

Tree = dict[Any, Any]
"""A scenario file as YAML has it, before it is validated."""

_LIMITS = {
    "greater_than": (">", "gt"),
    "greater_than_equal": (">=", "ge"),
    "less_than": ("<", "lt"),
    "less_than_equal": ("<=", "le"),
}
_TYPES = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "string_type": "text",
    "too_short": "at least one entry",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a mapping",
    "model_type": "a mapping of keys",
    "model_attributes_type": "a mapping of keys",
}
_STAND_INS = "; those of flight controllers are for stand-ins: `ptnsbc autopilot --fault`"
_LONGEST_VALUE = 60
_MOST_KEYS = 3


class ScenarioError(PtnsbcError):
    """A scenario file that cannot be read or does not describe a flight."""


class Problem(NamedTuple):
    """A key of a scenario that does not fit."""

    key: str
    value: str  # or what is wrong with it; empty where that takes too many words
    expected: str  # empty where the value says it
    advice: str = ""

    def __str__(self) -> str:
        """In one line, behind the name of the file."""
        expected = self.expected and f"expected {self.expected}"
        text = ": ".join(part for part in (self.key, self.value, expected) if part)
        return f"{text}; {self.advice}" if self.advice else text

    def below(self, where: str) -> Problem:
        """The same with the whole key, which begins with `where`."""
        return self._replace(key=f"{where}.{self.key}")


Problems = Iterator[Problem]


def unless(holds: object, key: str, value: object, expected: str) -> Problems:
    """The problem of a key unless what is expected holds."""
    if not holds:
        yield Problem(key, f"{value:g}" if isinstance(value, float) else str(value), expected)


def one_of(ids: Iterable[int], what: str = "ids under uavs") -> str:
    """The expectation of one of these UAVs."""
    return f"one of the {what}: {', '.join(map(str, sorted(ids))) or 'none'}"


def similar(word: object, known: Iterable[object]) -> str:
    """The tail of a message about an unknown word: the closest known one, or all of them."""
    names = [str(name) for name in known]
    match = difflib.get_close_matches(str(word), names, n=1, cutoff=0.6)
    if match:
        return f'did you mean "{match[0]}"?'
    return "expected one of: " + ", ".join(names) if names else "expected none here"


def _ending_in(word: object, keys: Iterable[str]) -> list[str]:
    """The first dotted keys whose last name is a word with its unit, or else closest to the word."""
    ends = {key: key.rpartition(".")[2] for key in keys}
    whole = [end for end in ends.values() if end.startswith(f"{word}_")]
    match = whole or difflib.get_close_matches(str(word), ends.values(), n=1)
    return [key for key, end in ends.items() if end in match][:_MOST_KEYS]


def shown(value: object) -> str:
    """A value as the user wrote it, cut to what fits on the line."""
    text = repr(value) if not isinstance(value, str) else f'"{value}"'
    text = " ".join(text.split())
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 1] + "…"


def _place_of(location: tuple[str | int, ...], tree: object) -> tuple[str, str, str]:
    """The key of a pydantic location in words, `uavs[2].position_m[1]`, its first and its last name.

    The tags of unions, which pydantic puts between the keys of the file, are left out.
    """
    text, names, node = "", [""], tree
    for position, key in enumerate(location):
        inside = isinstance(node, list) or (isinstance(node, Mapping) and key in node)
        if key == "[key]" or (not inside and position < len(location) - 1):
            continue
        if isinstance(node, list) and isinstance(key, int):
            text += f"[{key}]"
            node = node[key] if key < len(node) else None
        else:
            text += f".{key}" if text else str(key)
            node = node.get(key) if isinstance(node, Mapping) else None
        if isinstance(key, str):
            names.append(key)
    return text, names[min(1, len(names) - 1)], names[-1]


def _expectation(kind: str, first: str, last: str, detail: ErrorDetails) -> str:
    context = detail.get("ctx", {})
    if kind == "string_pattern_mismatch":
        if last == "process":
            return "expected uavN, bridgeN, sim or recorder"
        of_code = first in ("law", "plugins")
        return f"expected {'FILE.py:NAME' if of_code else 'a name of letters, digits, _ and -'}"
    if kind in _LIMITS:
        sign, key = _LIMITS[kind]
        return f"expected {sign} {context[key]:g}"
    if kind in _TYPES:
        return f"expected {_TYPES[kind]}"
    if kind in ("float_type", "float_parsing"):
        return f"expected {number_in(unit_of(last))}"
    if kind in ("literal_error", "union_tag_invalid"):
        names = str(context.get("expected", context.get("expected_tags", "")))
        words = [word.strip(" '") for word in names.replace(" or ", ",").split(",")]
        way_out = _STAND_INS if (first, last) == ("faults", "kind") else ""
        return similar(detail["input"], words) + way_out
    return " ".join(str(detail["msg"]).split())


def _line(detail: ErrorDetails, tree: object) -> str:
    kind = detail["type"]
    context = detail.get("ctx", {})
    where, first, last = _place_of((*detail["loc"], *context.get("below", ())), tree)
    if kind == "missing":
        what = number_in(unit_of(last)) if unit_of(last) else "this key"
        return f"{where}: missing: expected {what}"
    if kind == "union_tag_not_found":
        return f"{where}.kind: missing: expected this key"
    if kind == "unknown_key":
        key = context["below"][-1]
        found = similar(key, context["known"])
        if not found.startswith("did") and (deeper := _ending_in(key, context["deep"])):
            above = where.removesuffix(str(key))
            found = f"did you mean {' or '.join(above + one for one in deeper)}?"
        return f"{where}: unknown key: {found}"
    value = context.get("value", detail["input"])
    if kind == "union_tag_invalid":
        where, value = f"{where}.kind", context.get("tag")
        detail = {**detail, "input": value}
    return f"{where}: {shown(value)}: {_expectation(kind, first, last, detail)}"


def scenario_error(source: str, error: ValidationError, tree: object) -> ScenarioError:
    """The first problem of a validation, as one line that names the file."""
    details = error.errors(include_url=False)
    # A misspelt key is also a missing one; the misspelling says more.
    details.sort(key=lambda detail: detail["type"] != "unknown_key")
    more = len(details) - 1
    tail = "" if more == 0 else f" (and {more} more problem{'s' if more > 1 else ''})"
    return ScenarioError(f"{source}: {_line(details[0], tree)}{tail}")
