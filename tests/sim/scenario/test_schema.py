"""The JSON schema for editors: it accepts what the loader accepts, and refuses slips of a single key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ptnsbc_sim.scenario import schema
from ptnsbc_sim.scenario.reading import reader

jsonschema = pytest.importorskip("jsonschema")
SHIPPED = sorted((Path(__file__).parents[3] / "scenarios").glob("*.yaml"))


def _as_json(tree: Any) -> Any:
    """As an editor sees YAML: ids are text."""
    if isinstance(tree, dict):
        return {str(key): _as_json(value) for key, value in tree.items()}
    return [_as_json(item) for item in tree] if isinstance(tree, list) else tree


@pytest.fixture(scope="module")
def validator() -> Any:
    made = schema.schema()
    jsonschema.Draft202012Validator.check_schema(made)
    return jsonschema.Draft202012Validator(made)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_shipped_files_fit_and_name_it(path: Path, validator: Any) -> None:
    text = path.read_text("utf-8")
    validator.validate(_as_json(reader.parse(text, path.name)))
    modeline = text.splitlines()[0].removeprefix("# yaml-language-server: $schema=")
    assert (path.parent / modeline).resolve() == schema.FILE


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
def test_what_the_loader_takes_fits(text: str, validator: Any) -> None:
    validator.validate(_as_json(reader.parse(text, "test")))


@pytest.mark.parametrize(
    "text",
    [
        "sed: 3",
        "formation: {task: dance}",
        "timing: {duration_s: -1}",
        "uavs: [{id: 1, position_m: [0, 1]}]",
        "leader: {trajectory: {kind: circle, velocity_m_s: [1, 0, 0]}}",
    ],
)
def test_slips_are_refused(text: str, validator: Any) -> None:
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(_as_json(reader.parse(text, "test")))


def test_every_key_says_what_it_means() -> None:
    made = schema.schema()
    assert made["properties"]["seed"]["description"].startswith("Seed of all random numbers")
    turn = made["$defs"]["UavBlock"]["properties"]["attitude_rad"]["description"]
    assert turn == "Roll, pitch, yaw at the start. [rad]"
