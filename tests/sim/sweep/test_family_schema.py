"""The JSON schema of family files: it accepts the shipped ones, and refuses slips of a single key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ptnsbc_sim.scenario.reading import reader
from ptnsbc_sim.sweep import family_schema

jsonschema = pytest.importorskip("jsonschema")
SHIPPED = sorted((Path(__file__).parents[3] / "scenarios" / "families").glob("*.yaml"))


@pytest.fixture(scope="module")
def validator() -> Any:
    made = family_schema.schema()
    jsonschema.Draft202012Validator.check_schema(made)
    return jsonschema.Draft202012Validator(made)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_shipped_families_fit_and_name_it(path: Path, validator: Any) -> None:
    text = path.read_text("utf-8")
    validator.validate(reader.parse(text, path.name))
    modeline = text.splitlines()[0].removeprefix("# yaml-language-server: $schema=")
    assert (path.parent / modeline).resolve() == family_schema.FILE


@pytest.mark.parametrize(
    "text",
    [
        "siz: 3",
        "size: [3]",
        "tree: {kinds: [ladder]}",
        "starts: {sigma_m: wide}",
        "deadline: {seconds: [1, 2, 3]}",
    ],
)
def test_slips_are_refused(text: str, validator: Any) -> None:
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(reader.parse(text, "test"))


def test_every_key_says_what_it_means() -> None:
    made = family_schema.schema()
    blocks = [made, *(part for part in made["$defs"].values() if "properties" in part)]
    for key, value in ((k, v) for block in blocks for k, v in block["properties"].items()):
        assert value["description"], key
